#include "effigy/track/fit_box.h"

#include <Eigen/Cholesky>
#include <vector>

// BLAS: C = alpha A A^T + beta C, column-major, one triangle.
extern "C" void dsyrk_(const char* triangle, const char* transposed, const int* n, const int* k,
                       const double* alpha, const double* a, const int* a_stride,
                       const double* beta, double* c, const int* c_stride);

namespace effigy {
namespace {

// The lower triangle of J^T J. By BLAS, which chooses its kernels for this processor where Eigen's
// are those of the oldest: a twelfth of tracking's time went here.
void gauss_newton_hessian(const FitModel::Matrix& jacobian, Eigen::MatrixXd& hessian) {
  static_assert(FitModel::Matrix::IsRowMajor, "read as its transpose");
  const int n = static_cast<int>(jacobian.cols()), rows = static_cast<int>(jacobian.rows());
  const double one = 1, zero = 0;
  dsyrk_("L", "N", &n, &rows, &one, jacobian.data(), &n, &zero, hessian.data(), &n);
}

}  // namespace

Eigen::VectorXd minimise_quadratic_in_box(const Eigen::MatrixXd& h, const Eigen::VectorXd& g,
                                          const Eigen::VectorXd& low, const Eigen::VectorXd& high) {
  const int n = static_cast<int>(g.size());
  constexpr int kMostBlocks = 12, kMostPivots = 400;
  std::vector<int> side(static_cast<size_t>(n), 0);  // -1 at low, 1 at high, 0 free
  Eigen::VectorXd d = Eigen::VectorXd::Zero(n);
  std::vector<int> free;
  for (int pass = 0; pass < kMostPivots; ++pass) {
    free.clear();
    for (int i = 0; i < n; ++i) {
      if (side[i] == 0)
        free.push_back(i);
      else
        d[i] = side[i] < 0 ? low[i] : high[i];
    }
    const int m = static_cast<int>(free.size());
    const auto full = h.selfadjointView<Eigen::Lower>();
    Eigen::MatrixXd reduced(m, m);
    Eigen::VectorXd right(m);
    Eigen::VectorXd held = d;
    for (const int i : free) held[i] = 0;
    const Eigen::VectorXd pull = full * held + g;
    for (int a = 0; a < m; ++a) {
      right[a] = -pull[free[a]];
      for (int b = 0; b <= a; ++b) reduced(a, b) = h(free[a], free[b]);
    }
    const Eigen::VectorXd solved = reduced.llt().solve(right);
    for (int a = 0; a < m; ++a) d[free[a]] = solved[a];
    const Eigen::VectorXd slope = full * d + g;
    // What leaves the box is held, what is held against the slope is freed.
    bool changed = false;
    for (int i = n; i-- > 0;) {
      int wanted = side[i];
      if (side[i] == 0 && d[i] < low[i] - 1e-12) wanted = -1;
      if (side[i] == 0 && d[i] > high[i] + 1e-12) wanted = 1;
      if ((side[i] < 0 && slope[i] < -1e-12) || (side[i] > 0 && slope[i] > 1e-12)) wanted = 0;
      if (wanted == side[i]) continue;
      side[i] = wanted;
      changed = true;
      if (pass >= kMostBlocks) break;  // one at a time, always the last: ends for certain
    }
    if (!changed) break;
  }
  return d.cwiseMax(low).cwiseMin(high);
}

double minimise_in_box(const FrameCost& cost, const Eigen::VectorXd& lower,
                       const Eigen::VectorXd& upper, int steps, double tolerance,
                       Eigen::VectorXd& x) {
  const int rows = cost.num_residuals(), n = static_cast<int>(x.size());
  x = x.cwiseMax(lower).cwiseMin(upper);
  Eigen::VectorXd residuals(rows), trial_residuals(rows);
  FitModel::Matrix jacobian(rows, n);
  const double* block = x.data();
  double* to = jacobian.data();
  if (!cost.Evaluate(&block, residuals.data(), &to)) return 1e300;
  double value = 0.5 * residuals.squaredNorm(), damping = 0;
  Eigen::MatrixXd hessian = Eigen::MatrixXd::Zero(n, n);
  for (int step = 0; step < steps; ++step) {
    gauss_newton_hessian(jacobian, hessian);
    const Eigen::VectorXd diagonal = hessian.diagonal().array() + 1e-9;
    const Eigen::VectorXd gradient = jacobian.transpose() * residuals;
    bool gained = false;
    for (int attempt = 0; attempt < 6 && !gained; ++attempt) {
      hessian.diagonal() = diagonal * (1.0 + damping);
      Eigen::VectorXd trial =
          x + minimise_quadratic_in_box(hessian, gradient, lower - x, upper - x);
      trial = trial.cwiseMax(lower).cwiseMin(upper);
      const double* trial_block = trial.data();
      const bool valid =
          trial.allFinite() && cost.Evaluate(&trial_block, trial_residuals.data(), nullptr);
      const double trial_value = valid ? 0.5 * trial_residuals.squaredNorm() : 1e300;
      if (trial_value < value) {
        gained = true;
        const bool enough = value - trial_value > tolerance * value;
        x = trial;
        value = trial_value;
        damping = damping < 1e-4 ? 0 : 0.1 * damping;
        if (!enough || step + 1 == steps) return value;
        block = x.data();
        cost.Evaluate(&block, residuals.data(), &to);
      } else {
        damping = damping == 0 ? 1e-2 : 10 * damping;
      }
    }
    if (!gained) break;
  }
  return value;
}

}  // namespace effigy
