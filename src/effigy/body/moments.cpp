#include "effigy/body/moments.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/light/cubemap_layout.h"
#include "effigy/light/light_groups.h"

namespace effigy {
namespace {

constexpr int kEnvironmentSize = 64;
constexpr size_t kMeanFrames = 32;

Cubemap environment(const StageMoment& at) {
  return cubemap_from_equirectangular(read_environment(at.environment), kEnvironmentSize);
}

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
  return found_[key] = irradiance_of(frames, at, lit_as);
}

std::vector<float> StageMoments::irradiance_of(const TexelFrames& frames, const StageMoment& at,
                                               const StageMoment& lit_as) {
  const IrradianceSampling sampling{settings_.shadow_samples,
                                    settings_.seed + static_cast<uint64_t>(at.frame)};
  const RayScene& body = rays(at);
  std::vector<float> all;
  const auto add = [&](const std::vector<float>& picture) {
    all.insert(all.end(), picture.begin(), picture.end());
  };
  if (lit_as.environment.empty()) {
    for (const PointLights& part : group_points(points(lit_as), settings_.shadow_groups))
      add(irradiance_.of_points(frames, body, part, sampling));
    return all;
  }
  std::vector<EnvironmentSampler>& samplers = samplers_[lit_as.environment.string()];
  if (samplers.empty() && settings_.shadow_groups == 1)
    samplers.emplace_back(read_environment(lit_as.environment), 0.0, EnvironmentDraw::kLuminance);
  else if (samplers.empty())
    for (const Cubemap& part : group_environment(environment(lit_as), settings_.shadow_groups))
      samplers.emplace_back(part, EnvironmentDraw::kLuminance);
  for (const EnvironmentSampler& sampler : samplers)
    add(irradiance_.of_environment(frames, body, sampler, sampling));
  return all;
}

bool StageMoments::many(const StageMoment& at) const {
  return at.environment.empty() && at.fully_lit &&
         static_cast<int>(at.lights.lights.size()) >= settings_.environment_from;
}

std::shared_ptr<const BodyLight> StageMoments::light(const StageMoment& at) {
  const int groups = settings_.shadow ? settings_.shadow_groups : 1;
  if (at.environment.empty() && !many(at))
    return std::make_shared<BodyLight>(body_light(points(at), groups));
  auto& light = environments_[at.environment.string()];
  if (light != nullptr) return light;
  const bool table = settings_.environment_bands == "table";
  BodyLight found;
  if (many(at) && groups > 1) {
    // By lamps, as their irradiance is.
    for (const PointLights& part : group_points(points(at), groups))
      found.groups.push_back(body_light(stage_environment(part, kEnvironmentSize), 1, table));
  } else {
    const Cubemap radiance =
        many(at) ? stage_environment(at.lights, kEnvironmentSize) : environment(at);
    found = body_light(radiance, groups, table);
  }
  light = std::make_shared<BodyLight>(std::move(found));
  return light;
}

std::vector<float> StageMoments::mean_irradiance(const std::vector<int>& frames) {
  const size_t count = std::min(frames.size(), kMeanFrames);
  std::vector<float> mean(static_cast<size_t>(texels_.size) * static_cast<size_t>(texels_.size));
  for (size_t k = 0; k < count; ++k) {
    const StageMoment at = source_.moment(frames[k * frames.size() / count]);
    const std::vector<float>& picture = irradiance(at, at);
    const size_t pictures = picture.size() / mean.size();
    for (size_t i = 0; i < picture.size(); ++i)
      mean[i % mean.size()] += picture[i] / static_cast<float>(count * pictures);
  }
  return mean;
}

}  // namespace effigy
