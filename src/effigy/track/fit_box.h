// Least squares in a box, for one frame at a time. Private to track/.
#pragma once

#include <Eigen/Core>

#include "effigy/track/fit_cost.h"

namespace effigy {

// Minimises 1/2 |residuals|^2 of `cost`, whose only parameter block is x, with lower <= x <= upper:
// Gauss-Newton whose quadratic model is minimised inside the box exactly (many expressions rest on
// their limits, and a step that is merely cut at the limits hardly gains anything), with
// Levenberg-Marquardt damping after a step that fails. Ends after `steps` steps or when a step
// gains less than `tolerance` of the cost. Returns the cost.
double minimise_in_box(const FrameCost& cost, const Eigen::VectorXd& lower,
                       const Eigen::VectorXd& upper, int steps, double tolerance,
                       Eigen::VectorXd& x);

// Minimiser of 1/2 d'Hd + g'd with low <= d <= high, H symmetric positive definite (lower triangle
// read): block principal pivoting (Judice and Pires 1994), single pivots when blocks cycle.
Eigen::VectorXd minimise_quadratic_in_box(const Eigen::MatrixXd& h, const Eigen::VectorXd& g,
                                          const Eigen::VectorXd& low, const Eigen::VectorXd& high);

}  // namespace effigy
