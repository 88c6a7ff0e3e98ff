#include "effigy/body/moments.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/light/cubemap_layout.h"

namespace effigy {
namespace {

constexpr int kEnvironmentSize = 64;
constexpr size_t kMeanFrames = 32;

Vec3f middle_of(const std::vector<StageLight>& lights) {
  Vec3f sum = Vec3f::Zero();
  for (const StageLight& light : lights) sum += light.position;
  return lights.empty() ? sum : Vec3f(sum / static_cast<float>(lights.size()));
}

// A group of lamps of a stage whose middle is known.
PointLights points_about(const std::vector<StageLight>& lights, const Vec3f& middle, bool falloff) {
  PointLights points;
  points.falloff = falloff;
  points.center = middle;
  for (const StageLight& light : lights) {
    const float square = (light.position - middle).squaredNorm();
    points.lights.push_back({light.position, light.intensity / std::max(square, 1e-6f)});
  }
  return points;
}

// Keypoints in a root frame: the inverse of "world from rest" (3 x 4, a rotation and a shift).
std::vector<float> in_root(std::span<const float> keypoints, const std::array<float, 12>& frame) {
  Eigen::Map<const Eigen::Matrix<float, 3, 4, Eigen::RowMajor>> world(frame.data());
  const Mat3f turn = world.leftCols<3>().transpose();
  const Vec3f shift = world.col(3);
  std::vector<float> out(keypoints.size());
  for (size_t k = 0; k + 2 < keypoints.size(); k += 3)
    Eigen::Map<Vec3f>{&out[k]} = turn * (Eigen::Map<const Vec3f>(&keypoints[k]) - shift);
  return out;
}

}  // namespace

PointLights stage_points(const std::vector<StageLight>& lights, bool falloff) {
  return points_about(lights, middle_of(lights), falloff);
}

Cubemap stage_environment(const std::vector<StageLight>& lights, int size) {
  Cubemap radiance(size);
  const PointLights points = stage_points(lights, false);
  for (const PointLight& light : points.lights) {
    const CubePoint at = cube_point((light.position - points.center).cast<double>());
    const auto texel = [size](double s) {
      return std::clamp(static_cast<int>((s + 1) / 2 * size), 0, size - 1);
    };
    const int x = texel(at.s), y = texel(at.t);
    const auto angle = static_cast<float>(cubemap_solid_angle(x, y, size));
    float* out = &radiance.texels[3 * static_cast<size_t>((at.face * size + y) * size + x)];
    for (int c = 0; c < 3; ++c) out[c] += light.intensity[c] / angle;
  }
  return radiance;
}

StageMoments::StageMoments(const StageCapture& capture, const UvTexels& shadow_texels,
                           const BodyTrainSettings& settings)
    : capture_(capture), texels_(shadow_texels), settings_(settings), irradiance_(shadow_texels) {}

StageMoments::Keypoints StageMoments::keypoints(int frame) const {
  const auto f = static_cast<size_t>(frame);
  const size_t body = 3 * capture_.body_keypoint_names.size();
  const size_t face = 3 * capture_.face_keypoint_names.size();
  return {in_root({capture_.body_keypoints.data() + f * body, body}, capture_.body_from_rest[f]),
          in_root({capture_.face_keypoints.data() + f * face, face}, capture_.face_from_rest[f])};
}

BodyMoment StageMoments::moment(int frame, int frame_of_light) {
  BodyMoment moment;
  moment.vertices = load_frame_arrays(capture_, frame).tracked;
  if (rays_ == nullptr)
    rays_ = std::make_unique<RayScene>(moment.vertices, capture_.rig.mesh.triangles);
  else
    rays_->move(moment.vertices);
  Keypoints points = keypoints(frame);
  moment.body_keypoints = std::move(points.body);
  moment.face_keypoints = std::move(points.face);
  if (settings_.shadow) moment.irradiance = irradiance(frame, frame_of_light, moment.vertices);
  return moment;
}

const std::vector<float>& StageMoments::irradiance(int frame, int frame_of_light,
                                                   const std::vector<float>& vertices) {
  const std::pair key(frame, frame_of_light);
  const auto found = found_.find(key);
  if (found != found_.end()) return found->second;
  const TexelFrames frames = texel_frames(texels_, vertices, capture_.rig.mesh.triangles);
  const IrradianceSampling sampling{settings_.shadow_samples,
                                    settings_.seed + static_cast<uint64_t>(frame)};
  const std::string environment =
      capture_.frames[static_cast<size_t>(frame_of_light)].environment.string();
  if (environment.empty()) {
    const PointLights points =
        points_about(capture_.lights_of(frame), middle_of(capture_.lights), settings_.falloff);
    return found_[key] = irradiance_.of_points(frames, *rays_, points, sampling);
  }
  auto& sampler = samplers_[environment];
  if (sampler == nullptr)
    sampler = std::make_shared<EnvironmentSampler>(read_environment(capture_.folder / environment),
                                                   0.0, EnvironmentDraw::kLuminance);
  return found_[key] = irradiance_.of_environment(frames, *rays_, *sampler, sampling);
}

std::shared_ptr<const BodyLight> StageMoments::light(int frame) {
  const StageFrame& f = capture_.frames[static_cast<size_t>(frame)];
  const std::vector<StageLight> lights = capture_.lights_of(frame);
  const bool many = f.fully_lit && static_cast<int>(lights.size()) >= settings_.environment_from;
  if (f.environment.empty() && !many)
    return std::make_shared<BodyLight>(
        body_light(points_about(lights, middle_of(capture_.lights), settings_.falloff)));
  auto& light = environments_[f.environment.string()];
  if (light == nullptr)
    light = std::make_shared<BodyLight>(body_light(
        many ? stage_environment(lights, kEnvironmentSize)
             : cubemap_from_equirectangular(read_environment(capture_.folder / f.environment),
                                            kEnvironmentSize)));
  return light;
}

std::vector<float> StageMoments::mean_irradiance(const std::vector<int>& frames) {
  const size_t count = std::min(frames.size(), kMeanFrames);
  std::vector<float> mean(static_cast<size_t>(texels_.size) * static_cast<size_t>(texels_.size));
  for (size_t k = 0; k < count; ++k) {
    const std::vector<float> picture = moment(frames[k * frames.size() / count]).irradiance;
    for (size_t i = 0; i < mean.size(); ++i) mean[i] += picture[i] / static_cast<float>(count);
  }
  return mean;
}

}  // namespace effigy
