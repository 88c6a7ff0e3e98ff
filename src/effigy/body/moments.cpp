#include "effigy/body/moments.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/light/cubemap_layout.h"

namespace effigy {
namespace {

constexpr int kEnvironmentSize = 64;
constexpr size_t kMeanFrames = 32;

}  // namespace

Cubemap stage_environment(const PointLights& lamps, int size) {
  Cubemap radiance(size);
  for (const PointLight& lamp : lamps.lights) {
    const CubePoint at = cube_point((lamp.position - lamps.center).cast<double>());
    const auto texel = [size](double s) {
      return std::clamp(static_cast<int>((s + 1) / 2 * size), 0, size - 1);
    };
    const int x = texel(at.s), y = texel(at.t);
    const auto angle = static_cast<float>(cubemap_solid_angle(x, y, size));
    float* out = &radiance.texels[3 * static_cast<size_t>((at.face * size + y) * size + x)];
    for (int c = 0; c < 3; ++c) out[c] += lamp.intensity[c] / angle;
  }
  return radiance;
}

StageMoments::StageMoments(const StageSource& source, const UvTexels& shadow_texels,
                           const BodyTrainSettings& settings)
    : source_(source), texels_(shadow_texels), settings_(settings), irradiance_(shadow_texels) {}

PointLights StageMoments::points(const StageMoment& at) const {
  PointLights points = at.lights;
  points.falloff = settings_.falloff;
  return points;
}

BodyMoment StageMoments::moment(const StageMoment& at) const {
  const std::array<float, 12>& root =
      source_.capture().body_from_rest[static_cast<size_t>(at.frame)];
  const Eigen::Map<const Eigen::Matrix<float, 3, 4, Eigen::RowMajor>> world(root.data());
  return {at.vertices, at.body_keypoints, at.face_keypoints, world.leftCols<3>(), world.col(3)};
}

const RayScene& StageMoments::rays(const StageMoment& at) {
  if (rays_ == nullptr)
    rays_ = std::make_unique<RayScene>(at.vertices, source_.capture().rig.mesh.triangles);
  else
    rays_->move(at.vertices);
  return *rays_;
}

const std::vector<float>& StageMoments::irradiance(const StageMoment& at,
                                                   const StageMoment& lit_as) {
  static const std::vector<float> kNone;
  if (!settings_.shadow) return kNone;
  const std::pair key(at.frame, lit_as.frame);
  const auto found = found_.find(key);
  if (found != found_.end()) return found->second;
  const TexelFrames frames =
      texel_frames(texels_, at.vertices, source_.capture().rig.mesh.triangles);
  const IrradianceSampling sampling{settings_.shadow_samples,
                                    settings_.seed + static_cast<uint64_t>(at.frame)};
  if (lit_as.environment.empty())
    return found_[key] = irradiance_.of_points(frames, rays(at), points(lit_as), sampling);
  auto& sampler = samplers_[lit_as.environment.string()];
  if (sampler == nullptr)
    sampler = std::make_shared<EnvironmentSampler>(read_environment(lit_as.environment), 0.0,
                                                   EnvironmentDraw::kLuminance);
  return found_[key] = irradiance_.of_environment(frames, rays(at), *sampler, sampling);
}

std::shared_ptr<const BodyLight> StageMoments::light(const StageMoment& at) {
  const bool many =
      at.fully_lit && static_cast<int>(at.lights.lights.size()) >= settings_.environment_from;
  if (at.environment.empty() && !many) return std::make_shared<BodyLight>(body_light(points(at)));
  auto& light = environments_[at.environment.string()];
  if (light == nullptr)
    light = std::make_shared<BodyLight>(body_light(
        many ? stage_environment(at.lights, kEnvironmentSize)
             : cubemap_from_equirectangular(read_environment(at.environment), kEnvironmentSize)));
  return light;
}

std::vector<float> StageMoments::mean_irradiance(const std::vector<int>& frames) {
  const size_t count = std::min(frames.size(), kMeanFrames);
  std::vector<float> mean(static_cast<size_t>(texels_.size) * static_cast<size_t>(texels_.size));
  for (size_t k = 0; k < count; ++k) {
    const StageMoment at = source_.moment(frames[k * frames.size() / count]);
    const std::vector<float>& picture = irradiance(at, at);
    for (size_t i = 0; i < mean.size(); ++i) mean[i] += picture[i] / static_cast<float>(count);
  }
  return mean;
}

}  // namespace effigy
