// Described scenes of 3D Gaussians for the bare rasterizer (`effigy splat`): a folder as in
// scene_file.h whose scene.json has `kind` "gaussians" and `gaussians` [{center, rotation (w x y
// z), scale, opacity, features}] instead of texture and surfels.
#pragma once

#include "effigy/splat/gaussian_raster.h"
#include "effigy/splat/scene_file.h"

namespace effigy {

struct GaussianScene {
  Camera camera;
  Gaussians gaussians;
};

// Everything is checked, as by read_splat_scene; all Gaussians must have the same number of
// features.
GaussianScene read_gaussian_scene(const Path& folder);

// upstream_alpha.f32 and upstream_features.f32 as derivatives of every plane of the image; a
// missing file counts as zero, but one must be there.
Planes read_gaussian_upstream(const Path& folder, const GaussianScene& scene);

// alpha and features, each .f32.
void write_gaussian_outputs(const Path& folder, const Planes& image);

// grad_center rotation scale opacity features, each .f32.
void write_gaussian_gradients(const Path& folder, const Gaussians& gradients);

}  // namespace effigy
