// Described scenes for the bare rasterizer (`effigy splat`): a folder with scene.json and raw
// little-endian float32 arrays, height x width x channels, row 0 at the top of the image.
//
// scene.json: `camera` {width height fx fy cx cy, camera_from_world 4x4}, `texture` {width height
// file} (7 channels: albedo rgb, roughness, F0, normal x, normal y; row 0 at v = 0), `surfels`
// [{center, s, t, opacity, uv, uv_per_st [[du/ds, du/dt], [dv/ds, dv/dt]], frame [tangent,
// bitangent, normal]}]. Beside it, for gradients, upstream_<output>.f32: derivatives of a loss.
#pragma once

#include "effigy/base/file.h"
#include "effigy/geometry/types.h"
#include "effigy/splat/surfel_raster.h"

namespace effigy {

struct SplatScene {
  Camera camera;
  MaterialTexture texture;
  PosedSurfels surfels;
};

// What a folder describes: `kind` in scene.json, surfels when it is missing. Throws Error for
// others.
enum class SplatSceneKind { kSurfels, kGaussians };
SplatSceneKind splat_scene_kind(const Path& folder);

// A camera alone: a JSON file with the fields of `camera`, or with an object `camera`.
Camera read_scene_camera(const Path& file);

// Everything is checked: sizes, lengths, finite values, a camera that is a rigid motion. Throws
// Error naming file and field.
SplatScene read_splat_scene(const Path& folder);

// The rasterizer's options that the scenes are defined with: no low-pass, no threshold, the paper's
// UV distortion.
SurfelRasterOptions splat_scene_options();

// upstream_*.f32 as derivatives of every plane of the G-buffer; a missing file counts as zero, but
// one must be there.
Planes read_splat_upstream(const Path& folder, const Camera& camera);

// alpha depth material normal mapped_normal uv uv_distortion, each .f32.
void write_splat_outputs(const Path& folder, const Planes& gbuffer);

// grad_center s t opacity uv uv_per_st frame texture, each .f32.
void write_splat_gradients(const Path& folder, const PosedSurfels& d_surfels,
                           const std::vector<float>& d_texels);

}  // namespace effigy
