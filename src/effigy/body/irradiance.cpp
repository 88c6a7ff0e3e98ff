#include "effigy/body/irradiance.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/geometry/gutter.h"
#include "effigy/image/colour.h"
#include "effigy/rays/sampler.h"

namespace effigy {
namespace {

constexpr size_t kGrain = 64;
constexpr int kBlock = 8;  // texels
constexpr float kAway = 1e30f;

// Where rays of a texel begin, and which way its surface looks.
struct Site {
  Vec3f origin, normal;
};

Site site_of(const TexelFrames& frames, size_t i, float offset) {
  const float* r = &frames.rotation[9 * i];
  const Vec3f normal(r[2], r[5], r[8]);
  return {Vec3f(&frames.position[3 * i]) + offset * normal, normal};
}

// Whether nothing stands between `origin` and the end of `way`: the light itself, or infinity.
bool sees(const RayScene& body, const Vec3f& origin, const Vec3f& way, bool endless) {
  return !body.occluded(origin, way, 0.0f, endless ? kAway : 1.0f);
}

// The lights on a texel's front: ways to them and their strengths there.
class FrontLights {
 public:
  FrontLights(const PointLights& lights, const std::vector<float>& luminances)
      : lights_(lights), luminances_(luminances) {}

  void see_from(const Site& site) {
    way_.clear();
    strength_.clear();
    endless_.clear();
    all_ = front_ = 0;
    for (size_t k = 0; k < luminances_.size(); ++k) {
      const PointLight& light = lights_.lights[k];
      double strength = luminances_[k];
      Vec3f way = light.position;
      if (!light.directional) {
        way -= site.origin;
        if (lights_.falloff)
          strength *= static_cast<double>((light.position - lights_.center).squaredNorm()) /
                      std::max(static_cast<double>(way.squaredNorm()), 1e-12);
      }
      all_ += strength;
      if (!(strength > 0.0) || !(way.dot(site.normal) > 0.0f)) continue;
      front_ += strength;
      way_.push_back(way);
      strength_.push_back(strength);
      endless_.push_back(light.directional);
    }
  }

  // Eq. 15 by `samples` lights or all; u in [0, 1).
  double lit(const RayScene& body, const Vec3f& origin, int samples, double u) const {
    if (!(front_ > 0.0)) return 0.0;
    const auto reaches = [&](size_t k) { return sees(body, origin, way_[k], endless_[k]); };
    if (static_cast<size_t>(samples) >= way_.size()) {
      double seen = 0.0;
      for (size_t k = 0; k < way_.size(); ++k)
        if (reaches(k)) seen += strength_[k];
      return seen / all_;
    }
    // Systematic samples, u + 0, 1, 2 … steps along the strengths laid end to end: each light is
    // drawn strength / step times on average, and never a whole time fewer or more than that.
    const double step = front_ / samples;
    double end = 0.0;
    int drawn = 0, seen = 0;
    for (size_t k = 0; k < way_.size() && drawn < samples; ++k) {
      end += strength_[k];
      int times = 0;
      while (drawn + times < samples && (drawn + times + u) * step < end) ++times;
      if (k + 1 == way_.size()) times = samples - drawn;  // whatever the rounding
      if (times > 0 && reaches(k)) seen += times;
      drawn += times;
    }
    return seen * step / all_;
  }

 private:
  const PointLights& lights_;
  const std::vector<float>& luminances_;
  std::vector<Vec3f> way_;
  std::vector<double> strength_;
  std::vector<uint8_t> endless_;
  double all_ = 0, front_ = 0;
};

std::vector<float> luminances_of(const PointLights& lights) {
  std::vector<float> luminances;
  for (const PointLight& light : lights.lights) {
    if (!light.intensity.allFinite() || light.intensity.minCoeff() < 0)
      throw Error("Point light " + std::to_string(luminances.size()) +
                  " has an intensity that is negative or not finite; give it a brightness.");
    luminances.push_back(luminance(light.intensity.x(), light.intensity.y(), light.intensity.z()));
  }
  return luminances;
}

PixelSampler sampler_of(size_t texel, uint64_t seed) {
  return {static_cast<uint32_t>(texel), 0x1e55u, seed};
}

}  // namespace

TexelIrradiance::TexelIrradiance(const UvTexels& texels) : count_(texels.count()) {
  const size_t pixels = static_cast<size_t>(texels.size) * static_cast<size_t>(texels.size);
  std::vector<int32_t> shown(pixels, -1);
  for (size_t i = 0; i < count_; ++i)
    shown[static_cast<size_t>(texels.texel[i])] = static_cast<int32_t>(i);
  // Block by block of the atlas, which is place by place on the body: rays then meet the same parts
  // of the tree.
  order_.resize(count_);
  std::iota(order_.begin(), order_.end(), 0u);
  const auto block = [&](uint32_t i) {
    const int texel = texels.texel[i], x = texel % texels.size, y = texel / texels.size;
    return y / kBlock * texels.size + x / kBlock;
  };
  std::stable_sort(order_.begin(), order_.end(),
                   [&](uint32_t a, uint32_t b) { return block(a) < block(b); });
  const std::vector<int> nearest = nearest_shown(texels.size, shown);
  source_.resize(pixels);
  for (size_t i = 0; i < pixels; ++i) {
    EFFIGY_CHECK(nearest[i] >= 0);  // uv_texels() gives at least one
    source_[i] = shown[static_cast<size_t>(nearest[i])];
  }
}

std::vector<float> TexelIrradiance::of_points(const TexelFrames& frames, const RayScene& body,
                                              const PointLights& lights,
                                              const IrradianceSampling& sampling) const {
  EFFIGY_CHECK_EQ(frames.position.size(), 3 * count_);
  EFFIGY_CHECK(sampling.samples > 0);
  const std::vector<float> luminances = luminances_of(lights);
  std::vector<float> values(count_);
  parallel_for(count_, kGrain, [&](size_t begin, size_t end, int) {
    FrontLights front(lights, luminances);
    for (size_t k = begin; k < end; ++k) {
      const size_t i = order_[k];
      const Site site = site_of(frames, i, sampling.offset);
      front.see_from(site);
      PixelSampler sampler = sampler_of(i, sampling.seed);
      sampler.start(0);
      const double lit = front.lit(body, site.origin, sampling.samples, sampler.next().x());
      values[i] = std::clamp(static_cast<float>(lit), 0.0f, 1.0f);
    }
  });
  return picture(values);
}

std::vector<float> TexelIrradiance::of_environment(const TexelFrames& frames, const RayScene& body,
                                                   const EnvironmentSampler& light,
                                                   const IrradianceSampling& sampling) const {
  EFFIGY_CHECK_EQ(frames.position.size(), 3 * count_);
  EFFIGY_CHECK(sampling.samples > 0);
  EFFIGY_CHECK(light.draw() == EnvironmentDraw::kLuminance);
  std::vector<float> values(count_);
  parallel_for(count_, kGrain, [&](size_t begin, size_t end, int) {
    for (size_t k = begin; k < end; ++k) {
      const size_t i = order_[k];
      const Site site = site_of(frames, i, sampling.offset);
      PixelSampler sampler = sampler_of(i, sampling.seed);
      int seen = 0;
      for (int s = 0; s < sampling.samples; ++s) {
        sampler.start(static_cast<uint32_t>(s));
        const EnvironmentSampler::Sample drawn = light.sample(sampler.next());
        if (drawn.density > 0 && drawn.direction.dot(site.normal) > 0 &&
            sees(body, site.origin, drawn.direction, true))
          ++seen;
      }
      values[i] = static_cast<float>(seen) / static_cast<float>(sampling.samples);
    }
  });
  return picture(values);
}

std::vector<float> TexelIrradiance::picture(const std::vector<float>& values) const {
  std::vector<float> picture(source_.size());
  for (size_t i = 0; i < picture.size(); ++i) picture[i] = values[static_cast<size_t>(source_[i])];
  return picture;
}

}  // namespace effigy
