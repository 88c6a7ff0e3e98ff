#include "effigy/head/start_texture.h"

#include <algorithm>
#include <cmath>

#include "effigy/head/frames.h"
#include "effigy/head/start_light.h"
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
constexpr int kPatches = 64;           // patches of the surface a side of the atlas
constexpr int kSampleStep = 3;         // every n-th pixel tells of the light
constexpr float kLeastLight = 0.1f;    // of the mean, that colours are divided by

// Linear radiance of an image value; clipped highlights are taken as just clipped.
float radiance_of(float value, DisplayTransform display) {
  const float linear = linear_from_srgb(value);
  return display == DisplayTransform::kReinhardSrgb ? linear / (1 - std::min(linear, 0.95f))
                                                    : linear;
}

// Calls visit(pixel, unit normal, cosine between normal and ray) for the pixels of the G-buffer
// that are surely the head's and not seen edge-on.
template <typename Visit>
void visit_surface(const Planes& gbuffer, const Camera& camera, const TargetFrame& target, int step,
                   const Visit& visit) {
  for (int y = 0; y < camera.height; y += step)
    for (int x = 0; x < camera.width; x += step) {
      const size_t i = static_cast<size_t>(y) * camera.width + x;
      if (target.mask.data[i] < kSureMatte) continue;
      const Vec3d in_camera((x + 0.5 - camera.cx) / camera.fx, (y + 0.5 - camera.cy) / camera.fy,
                            1);
      const Vec3d ray = camera.camera_from_world_rotation.transpose() * in_camera;
      Vec3d normal;
      for (int c = 0; c < 3; ++c) normal[c] = gbuffer.plane(kNormal + c)[i];
      normal.normalize();
      const auto facing = static_cast<float>(-normal.dot(ray.normalized()));
      if (facing > kLeastFacing) visit(i, Vec3f(normal.cast<float>()), facing);
    }
}

// What the frames show, drawn on the start's surfels.
class StartFrames {
 public:
  StartFrames(const Capture& capture, const std::vector<int>& frames, const HeadModel& model,
              int size)
      : capture_(capture), frames_(frames), model_(model), grey_(size, size), store_(capture, 0) {}

  std::vector<SurfaceSample> samples();
  // [texel][8] sums over all pixels: 0 to 2 the linear colour over the light's response to the
  // normal, times the weight; 3 the weight.
  std::vector<float> gather(const Cubemap& response);

 private:
  void draw(int frame) {
    store_.load(frame, target_);
    pose_vertices(model_.shape, capture_.poses[frame], vertices_);
    pose_surfels(capture_.rig.mesh, vertices_, model_.surfels, {}, posed_);
    render_surfels(capture_.camera, posed_, grey_, {}, gbuffer_, raster_);
  }
  float radiance(int channel, size_t pixel) const {
    return radiance_of(target_.image.plane(channel)[pixel], capture_.display);
  }

  const Capture& capture_;
  const std::vector<int>& frames_;
  const HeadModel& model_;
  const MaterialTexture grey_;
  FrameStore store_;
  TargetFrame target_;
  std::vector<float> vertices_;
  PosedSurfels posed_;
  SurfelFrame raster_;
  Planes gbuffer_;
};

std::vector<SurfaceSample> StartFrames::samples() {
  std::vector<SurfaceSample> samples;
  for (const int frame : frames_) {
    draw(frame);
    visit_surface(gbuffer_, capture_.camera, target_, kSampleStep,
                  [&](size_t i, const Vec3f& normal, float) {
                    const auto cell = [&](int axis) {
                      const float at = gbuffer_.plane(kUv + axis)[i] / gbuffer_.plane(kAlpha)[i];
                      return std::clamp(static_cast<int>(at * kPatches), 0, kPatches - 1);
                    };
                    samples.push_back({normal,
                                       {radiance(0, i), radiance(1, i), radiance(2, i)},
                                       cell(1) * kPatches + cell(0)});
                  });
  }
  return samples;
}

// The colours are gathered by the derivative of "sum over pixels of weight times (colour, 1)" with
// respect to the G-buffer: its backward pass sums them on the texels that the pixels see.
std::vector<float> StartFrames::gather(const Cubemap& response) {
  std::vector<float> sums(grey_.texels.size(), 0.0f);
  PosedSurfels d_posed;
  Planes d_gbuffer(capture_.camera.width, capture_.camera.height, kGBufferPlanes);
  for (const int frame : frames_) {
    draw(frame);
    std::fill(d_gbuffer.data.begin(), d_gbuffer.data.end(), 0.0f);
    visit_surface(gbuffer_, capture_.camera, target_, 1,
                  [&](size_t i, const Vec3f& normal, float facing) {
                    const float weight = facing * facing;
                    const Vec3f light = sample_cubemap(response, normal);
                    for (int c = 0; c < 3; ++c)
                      d_gbuffer.plane(kAlbedo + c)[i] =
                          weight * radiance(c, i) / std::max(light[c], kLeastLight);
                    d_gbuffer.plane(kRoughness)[i] = weight;
                  });
    d_posed.resize(0);
    d_posed.resize(posed_.count());
    render_surfels_backward(capture_.camera, posed_, grey_, {}, gbuffer_, raster_, d_gbuffer,
                            d_posed, sums);
  }
  return sums;
}

}  // namespace

void start_from_frames(const Capture& capture, const TrainSettings& settings,
                       const std::vector<int>& frames, HeadModel& model) {
  const int size = settings.texture_size;
  StartFrames start(capture, frames, model, size);
  const Cubemap light = settings.start_light
                            ? start_light(start.samples(), kPatches * kPatches, kEnvironmentSize)
                            : Cubemap(kEnvironmentSize, 1.0f);
  const std::vector<float> sums = start.gather(diffuse_response(light));
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
  for (size_t i = 0; i < model.environment.size(); ++i)
    model.environment[i] = std::log(radiance * light.texels[i]);
}

}  // namespace effigy
