#include "effigy/head/start_texture.h"

#include <algorithm>
#include <cmath>

#include "effigy/head/frames.h"
#include "effigy/head/surface_fill.h"
#include "effigy/image/colour.h"
#include "effigy/splat/surfel_raster.h"

namespace effigy {
namespace {

constexpr float kSureMatte = 0.95f;    // pixels nearer to the matte's edge show the background too
constexpr float kLeastFacing = 0.2f;   // cosine between normal and ray
constexpr float kEnough = 0.5f;        // pixels' worth of weight that decide a texel's colour
constexpr double kBrightest = 0.98;    // this share of the texels gets an albedo under
constexpr float kBrightAlbedo = 0.8f;  // this one
constexpr float kReflected = 0.05f;    // what F0 reflects of an even light

// Linear radiance of an image value; clipped highlights are taken as just clipped.
float radiance_of(float value, DisplayTransform display) {
  const float linear = linear_from_srgb(value);
  return display == DisplayTransform::kReinhardSrgb ? linear / (1 - std::min(linear, 0.95f))
                                                    : linear;
}

// Derivative of "sum over pixels of weight times (colour, 1)" with respect to the G-buffer: its
// backward pass through the rasterizer sums the weighted colours on the texels that pixels see.
void gather_frame(const Planes& gbuffer, const Camera& camera, DisplayTransform display,
                  const TargetFrame& target, Planes& d_gbuffer) {
  std::fill(d_gbuffer.data.begin(), d_gbuffer.data.end(), 0.0f);
  for (int y = 0; y < camera.height; ++y)
    for (int x = 0; x < camera.width; ++x) {
      const size_t i = static_cast<size_t>(y) * camera.width + x;
      if (target.mask.data[i] < kSureMatte) continue;
      const Vec3d in_camera((x + 0.5 - camera.cx) / camera.fx, (y + 0.5 - camera.cy) / camera.fy,
                            1);
      const Vec3d ray = camera.camera_from_world_rotation.transpose() * in_camera;
      Vec3d normal;
      for (int c = 0; c < 3; ++c) normal[c] = gbuffer.plane(kNormal + c)[i];
      const auto facing = static_cast<float>(-normal.normalized().dot(ray.normalized()));
      if (!(facing > kLeastFacing)) continue;
      const float weight = facing * facing;
      for (int c = 0; c < 3; ++c)
        d_gbuffer.plane(kAlbedo + c)[i] = weight * radiance_of(target.image.plane(c)[i], display);
      d_gbuffer.plane(kRoughness)[i] = weight;
    }
}

// [texel][8] sums over all pixels of `frames`: 0 to 2 the linear colour times the weight, 3 the
// weight.
std::vector<float> gather(const Capture& capture, const std::vector<int>& frames,
                          const HeadModel& model, int size) {
  const MaterialTexture grey(size, size);
  std::vector<float> sums(grey.texels.size(), 0.0f), vertices;
  PosedSurfels posed, d_posed;
  SurfelFrame raster;
  Planes gbuffer, d_gbuffer(capture.camera.width, capture.camera.height, kGBufferPlanes);
  FrameStore store(capture, 0);
  TargetFrame target;
  for (const int frame : frames) {
    store.load(frame, target);
    pose_vertices(model.shape, capture.poses[frame], vertices);
    pose_surfels(capture.rig.mesh, vertices, model.surfels, {}, posed);
    render_surfels(capture.camera, posed, grey, {}, gbuffer, raster);
    gather_frame(gbuffer, capture.camera, capture.display, target, d_gbuffer);
    d_posed.resize(0);
    d_posed.resize(posed.count());
    render_surfels_backward(capture.camera, posed, grey, {}, gbuffer, raster, d_gbuffer, d_posed,
                            sums);
  }
  return sums;
}

}  // namespace

void start_from_frames(const Capture& capture, const TrainSettings& settings,
                       const std::vector<int>& frames, HeadModel& model) {
  const int size = settings.texture_size;
  const std::vector<float> sums = gather(capture, frames, model, size);
  const size_t texels = static_cast<size_t>(size) * size;
  std::vector<float> colour(3 * texels, 0.0f), weight(texels), bright;
  for (size_t t = 0; t < texels; ++t) {
    weight[t] = sums[8 * t + 3];
    if (weight[t] <= 0) continue;
    for (size_t c = 0; c < 3; ++c) colour[3 * t + c] = sums[8 * t + c] / weight[t];
    if (weight[t] > kEnough)
      bright.push_back(std::max({colour[3 * t], colour[3 * t + 1], colour[3 * t + 2]}));
  }
  if (bright.empty()) return;  // nothing is seen: the plain start remains
  const auto rank = bright.begin() + static_cast<std::ptrdiff_t>(
                                         kBrightest * static_cast<double>(bright.size() - 1));
  std::nth_element(bright.begin(), rank, bright.end());
  const float radiance = std::clamp(*rank / kBrightAlbedo, 0.02f, 50.0f);
  Mesh mesh = capture.rig.mesh;
  mesh.vertices = model.shape.rest;
  fill_over_surface(mesh, size, 3, kEnough, weight, colour);

  MaterialTexture texture;
  activate_texture(model.material, {}, texture);
  const UvMask mask = uv_mask(mesh, size);
  for (size_t t = 0; t < texels; ++t)
    for (size_t c = 0; c < 3 && (mask.flags()[t] & 1) != 0; ++c)
      texture.texels[8 * t + c] =
          std::clamp((colour[3 * t + c] / radiance - kReflected) / (1 - kReflected), 0.005f, 0.95f);
  model.material = texture_parameters_of(texture, {});
  std::fill(model.environment.begin(), model.environment.end(), std::log(radiance));
}

}  // namespace effigy
