// Fitting a rig's identity to a scan or another template: rigid alignment and identity modes by
// point-to-plane ICP (Besl and McKay 1992; Chen and Medioni 1992), then per-vertex offsets whose
// Laplacian stays small (as in optimal-step non-rigid ICP, Amberg et al. 2007).
#pragma once

#include <span>

#include "effigy/rig/rig.h"

namespace effigy {

struct SurfaceFitOptions {
  int mode_iterations = 30, offset_iterations = 8;
  double landmark_weight = 0.02;  // of one landmark against the mean over the surface
  double prior_weight = 2e-4;     // of one standard deviation of identity, against 1 mm^2
  double furthest = 0.020;        // metres: pairs further apart are left out
  double stiffness = 3.0;         // of the offsets' Laplacian at the first iteration; halves
  bool scale = false;             // the target's unit is not known: the landmarks give it
};

struct SurfaceFit {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();  // target_from_rig
  Vec3d translation = Vec3d::Zero();
  double scale = 1;  // target units per metre
  std::vector<float> identity;
  std::vector<float> offsets;  // 3V, metres, in the rig's frame, to add to the rest shape
  // Mean distances in metres of the rig. From points of the target to the fitted surface: after
  // pose and identity alone, and with the offsets; and between the landmarks, 17 to 67 (the outline
  // slides).
  double identity_distance = 0, distance = 0;
  double identity_landmark_distance = 0, landmark_distance = 0;
};

// The rest vertices of the fit in the target's frame, 3V; `with_offsets` false: identity alone.
std::vector<float> fitted_vertices(const Rig& rig, const SurfaceFit& fit, bool with_offsets);

// Fits the part "skin" of `rig` to the part "skin" of `target` (each: the whole mesh when there is
// no such part) and its 68 MultiPIE `landmarks` (3 x 68, in the target's unit; those that are not
// finite are not known, at least four of 17 to 67 are). Without options.scale both are in metres;
// identity's modes cannot be told from a scale otherwise. What of the target lies below the rig's
// neck ring does not count. Throws Error when the rig has not all 68 landmarks, too few are known,
// or the target has no triangles.
SurfaceFit fit_surface(const Rig& rig, const Mesh& target, std::span<const float> landmarks,
                       const SurfaceFitOptions& options = {});

}  // namespace effigy
