#include "effigy/learn/texture_losses.h"

#include <gtest/gtest.h>
#include <hwy/targets.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <limits>

#include "effigy/base/error.h"
#include "effigy/base/random.h"
#include "effigy/base/threads.h"

namespace effigy {
namespace {

using Doubles = std::vector<double>;

// Runs the body once per instruction set that this machine has (the plain C++ fallback included).
void for_each_target(const std::function<void(const char*)>& body) {
  for (const int64_t target : hwy::SupportedAndGeneratedTargets()) {
    hwy::SetSupportedTargetsForTest(target);
    hwy::GetChosenTarget().DeInit();
    body(hwy::TargetName(target));
  }
  hwy::SetSupportedTargetsForTest(HWY_SCALAR);
  hwy::GetChosenTarget().DeInit();
  body("SCALAR");
  hwy::SetSupportedTargetsForTest(0);
  hwy::GetChosenTarget().DeInit();
}

// An island with a hole and a second island, in a width x height atlas.
std::vector<uint8_t> islands(int width, int height) {
  std::vector<uint8_t> inside(static_cast<size_t>(width) * height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const bool first = x >= 1 && x < width * 6 / 10 && y >= 2 && y < height - 1;
      const bool hole = x >= 3 && x < 5 && y >= 4 && y < 7;
      const bool second = x >= width * 7 / 10 && y < height / 2;
      inside[static_cast<size_t>(y) * width + x] = (first && !hole) || second;
    }
  return inside;
}

void activate_texel(const TextureActivation& a, const double* raw, double* t) {
  const auto sigmoid = [](double x) { return 1 / (1 + std::exp(-x)); };
  for (int k = 0; k < 3; ++k) t[k] = sigmoid(raw[k]);
  t[3] = a.roughness_low + (a.roughness_high - a.roughness_low) * sigmoid(raw[3]);
  t[4] = a.specular_low + (a.specular_high - a.specular_low) * sigmoid(raw[4]);
  t[5] = std::tanh(raw[5]);
  t[6] = std::tanh(raw[6]);
  const double length = std::hypot(t[5], t[6]);
  if (length > a.normal_limit) {
    t[5] *= a.normal_limit / length;
    t[6] *= a.normal_limit / length;
  }
  t[7] = 0;
}

double normal_l1(const double* t) {
  return std::abs(t[5]) + std::abs(t[6]) + 1 - std::sqrt(1 - t[5] * t[5] - t[6] * t[6]);
}

// All losses by their definitions, in double precision, from raw parameters.
TextureLosses oracle(const Doubles& raw, const std::vector<uint8_t>& inside, int width, int height,
                     const TextureActivation& activation, const TextureLossSettings& s) {
  Doubles t(raw.size());
  for (size_t i = 0; i < inside.size(); ++i)
    activate_texel(activation, raw.data() + 8 * i, t.data() + 8 * i);
  double count_in = 0, count_out = 0;
  double tv[8] = {};
  TextureLosses losses;
  const auto at = [&](int x, int y) { return static_cast<size_t>(y) * width + x; };
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const size_t i = at(x, y);
      const double* texel = t.data() + 8 * i;
      if (!inside[i]) {
        ++count_out;
        const double target[5] = {s.outside.albedo[0], s.outside.albedo[1], s.outside.albedo[2],
                                  s.outside.roughness, s.outside.specular};
        for (int k = 0; k < 5; ++k) losses.boundary += std::abs(texel[k] - target[k]);
        losses.boundary += normal_l1(texel);
        continue;
      }
      ++count_in;
      losses.normal += normal_l1(texel);
      losses.roughness_prior += std::pow(texel[3] - s.roughness_target, 2);
      losses.specular_prior += std::pow(texel[4] - s.specular_target, 2);
      if (s.albedo_target != nullptr)
        for (size_t k = 0; k < 3; ++k)
          losses.albedo_prior += std::abs(texel[k] - s.albedo_target->texels[8 * i + k]);
      for (const auto& [dx, dy] : {std::pair{1, 0}, std::pair{0, 1}}) {
        if (x + dx >= width || y + dy >= height || !inside[at(x + dx, y + dy)]) continue;
        for (int k = 0; k < 5; ++k) {
          const double d = texel[k] - t[8 * at(x + dx, y + dy) + static_cast<size_t>(k)];
          tv[k] += s.tv_squared ? d * d : std::abs(d);
        }
      }
    }
  losses.albedo_tv = (tv[0] + tv[1] + tv[2]) / 3 / count_in;
  losses.roughness_tv = tv[3] / count_in;
  losses.specular_tv = tv[4] / count_in;
  losses.normal /= count_in;
  losses.roughness_prior /= count_in;
  losses.specular_prior /= count_in;
  losses.albedo_prior /= count_in;
  losses.boundary /= count_out;
  return losses;
}

struct Case {
  int width, height;
  std::vector<uint8_t> inside;
  UvMask mask;
  TextureActivation activation;
  TextureLossSettings settings;
  TextureParameters parameters;
  MaterialTexture texture, prior;
  std::vector<float> d_texels;

  explicit Case(uint64_t seed, int w = 14, int h = 11)
      : width(w), height(h), inside(islands(w, h)), mask(inside, w, h) {
    Random random(seed);
    parameters = make_texture_parameters(mask, activation, {}, settings.outside);
    for (size_t i = 0; i < parameters.raw.size(); ++i)
      if (i % 8 != 7) parameters.raw[i] += static_cast<float>(0.7 * random.normal());
    // Some normals at the limit (in a wide atlas not everywhere: its runs have a path of their
    // own).
    for (size_t i = 0; i < inside.size() / (w > 64 ? 2 : 1); i += 5) {
      parameters.raw[8 * i + 5] = static_cast<float>(random.uniform(-3.0, 3.0));
      parameters.raw[8 * i + 6] = 1.9f;
    }
    activate_texture(parameters, activation, texture);
    d_texels.resize(parameters.raw.size());
    for (size_t i = 0; i < d_texels.size(); ++i)
      d_texels[i] = i % 8 == 7 ? 0.0f : static_cast<float>(1e-3 * random.normal());
    prior = MaterialTexture(width, height);
    for (float& value : prior.texels) value = static_cast<float>(random.uniform());
    settings.boundary_tolerance = 0.0f;
    settings.albedo_tv = 0.3f;
    settings.roughness_tv = 0.5f;
    settings.specular_tv = 0.7f;
    settings.normal = 0.2f;
    settings.boundary = 0.9f;
    settings.roughness_prior = 0.4f;
    settings.specular_prior = 0.6f;
    settings.albedo_prior = 0.8f;
    settings.albedo_target = &prior;
  }
  Doubles raw() const { return Doubles(parameters.raw.begin(), parameters.raw.end()); }
  TextureLosses losses(const Doubles& values) const {
    return oracle(values, inside, width, height, activation, settings);
  }
  // Total of the losses and of d_texels . texture, a stand-in for the image losses.
  double total(const Doubles& values) const {
    double sum = losses(values).total(settings);
    for (size_t i = 0; i < inside.size(); ++i) {
      double t[8];
      activate_texel(activation, values.data() + 8 * i, t);
      for (size_t k = 0; k < 7; ++k) sum += d_texels[8 * i + k] * t[k];
    }
    return sum;
  }
  Doubles numeric_gradient(size_t stride = 1) const {
    Doubles values = raw(), gradient(values.size());
    for (size_t i = 0; i < values.size(); i += stride) {
      if (i % 8 == 7) continue;
      const double keep = values[i], h = 1e-6;
      values[i] = keep + h;
      const double up = total(values);
      values[i] = keep - h;
      gradient[i] = (up - total(values)) / (2 * h);
      values[i] = keep;
    }
    return gradient;
  }
};

void expect_losses(const TextureLosses& got, const TextureLosses& want) {
  EXPECT_NEAR(got.roughness_tv, want.roughness_tv, 1e-5);
  EXPECT_NEAR(got.specular_tv, want.specular_tv, 1e-5);
  EXPECT_NEAR(got.albedo_tv, want.albedo_tv, 1e-5);
  EXPECT_NEAR(got.normal, want.normal, 1e-5);
  EXPECT_NEAR(got.boundary, want.boundary, 1e-5);
  EXPECT_NEAR(got.roughness_prior, want.roughness_prior, 1e-5);
  EXPECT_NEAR(got.specular_prior, want.specular_prior, 1e-5);
  EXPECT_NEAR(got.albedo_prior, want.albedo_prior, 1e-5);
}

TEST(TextureLosses, GradientMatchesFiniteDifferencesOnEveryTarget) {
  for (const int variant : {0, 1, 2, 3}) {
    const bool wide = variant >= 2;  // with runs that are all inside and all outside
    Case c(3, wide ? 170 : 14, wide ? 8 : 11);
    c.settings.tv_squared = variant % 2 == 1;
    if (wide) {
      c.settings.albedo_target = nullptr;
      c.settings.roughness_prior = c.settings.specular_prior = c.settings.albedo_prior = 0;
      ASSERT_GE(std::count(c.mask.runs().begin(), c.mask.runs().end(), 1), 4);
      ASSERT_GE(std::count(c.mask.runs().begin(), c.mask.runs().end(), 2), 4);
    }
    // Losses without weight are reported as 0.
    TextureLosses losses = c.losses(c.raw());
    if (wide) losses.roughness_prior = losses.specular_prior = 0;
    const size_t stride = wide ? 61 : 1;
    const Doubles want = c.numeric_gradient(stride);
    for_each_target([&](const char* name) {
      SCOPED_TRACE(name);
      std::vector<float> got(want.size(), -7.0f);
      const TextureStep result = texture_gradient(c.parameters, c.activation, c.mask, c.settings,
                                                  c.texture, c.d_texels, got);
      expect_losses(result.losses, losses);
      EXPECT_EQ(result.not_finite, 0u);
      for (size_t i = 0; i < want.size(); i += stride)
        ASSERT_NEAR(got[i], want[i], 2e-6 + 1e-4 * std::abs(want[i])) << i / 8 << " " << i % 8;
    });
  }
}

// Three steps against Adam in double precision on gradients from finite differences.
TEST(TextureLosses, StepIsAdamOnTheGradientOnEveryTarget) {
  for_each_target([&](const char* name) {
    SCOPED_TRACE(name);
    Case c(5);
    const std::vector<float> d_texels = c.d_texels;
    const TextureRates rates{2e-3f, 3e-3f, 4e-3f, 1e-3f};
    const double rate[8] = {2e-3, 2e-3, 2e-3, 3e-3, 4e-3, 1e-3, 1e-3, 0};
    Doubles raw = c.raw(), m(raw.size()), v(raw.size());
    for (int t = 1; t <= 3; ++t) {
      std::vector<float> gradient(raw.size());
      texture_gradient(c.parameters, c.activation, c.mask, c.settings, c.texture, d_texels,
                       gradient);
      const TextureLosses before = c.losses(c.raw());
      c.d_texels = d_texels;
      const TextureStep result = texture_step(c.parameters, c.activation, c.mask, c.settings, rates,
                                              {}, c.texture, c.d_texels);
      expect_losses(result.losses, before);
      for (size_t i = 0; i < raw.size(); ++i) {
        m[i] = 0.9 * m[i] + 0.1 * gradient[i];
        v[i] = 0.999 * v[i] + 0.001 * static_cast<double>(gradient[i]) * gradient[i];
        raw[i] -= rate[i % 8] * (m[i] / (1 - std::pow(0.9, t))) /
                  (std::sqrt(v[i] / (1 - std::pow(0.999, t))) + 1e-15);
        ASSERT_NEAR(c.parameters.raw[i], raw[i], 1e-6 + 1e-6 * std::abs(raw[i])) << t << " " << i;
        ASSERT_EQ(c.d_texels[i], 0.0f);
      }
      // The texture is the activation of the new parameters, bit for bit.
      MaterialTexture fresh;
      activate_texture(c.parameters, c.activation, fresh);
      ASSERT_EQ(fresh.texels, c.texture.texels);
    }
    EXPECT_EQ(c.parameters.adam.step, 3);
  });
}

TEST(TextureLosses, ActivationMatchesDoublePrecisionAndRanges) {
  Case c(9);
  c.parameters.raw[0] = 90.0f;
  c.parameters.raw[1] = -90.0f;
  c.parameters.raw[5] = 40.0f;
  c.parameters.raw[6] = -40.0f;
  for_each_target([&](const char* name) {
    SCOPED_TRACE(name);
    activate_texture(c.parameters, c.activation, c.texture);
    for (size_t i = 0; i < c.inside.size(); ++i) {
      double raw[8], want[8];
      for (size_t k = 0; k < 8; ++k) raw[k] = c.parameters.raw[8 * i + k];
      activate_texel(c.activation, raw, want);
      const float* t = c.texture.texels.data() + 8 * i;
      for (int k = 0; k < 8; ++k) ASSERT_NEAR(t[k], want[k], 1e-6) << i << " " << k;
      EXPECT_LE(std::hypot(t[5], t[6]), c.activation.normal_limit + 1e-6f);
      EXPECT_GE(t[3], 0.04f);
      EXPECT_EQ(t[7], 0.0f);
    }
  });
}

TEST(TextureLosses, InitialValuesAndInverse) {
  Case c(11);
  const TexelValue skin{{0.45f, 0.3f, 0.22f}, 0.6f, 0.04f};
  const TextureParameters p =
      make_texture_parameters(c.mask, c.activation, skin, c.settings.outside);
  MaterialTexture t;
  activate_texture(p, c.activation, t);
  for (size_t i = 0; i < c.inside.size(); ++i) {
    const float* texel = t.texels.data() + 8 * i;
    const bool in = c.inside[i] != 0;
    EXPECT_NEAR(texel[0], in ? 0.45 : 0.0, in ? 1e-6 : 2e-4);
    EXPECT_NEAR(texel[2], in ? 0.22 : 0.0, in ? 1e-6 : 2e-4);
    EXPECT_NEAR(texel[3], in ? 0.6 : 0.5, 1e-6);
    EXPECT_NEAR(texel[4], in ? 0.04 : 0.05, 1e-6);
    EXPECT_EQ(texel[5], 0.0f);
  }
  const TextureParameters back = texture_parameters_of(c.texture, c.activation);
  MaterialTexture again;
  activate_texture(back, c.activation, again);
  for (size_t i = 0; i < again.texels.size(); ++i)
    EXPECT_NEAR(again.texels[i], c.texture.texels[i], 2.1e-4) << i;
}

TEST(TextureLosses, GradientsThatAreNotFiniteCountAsZero) {
  for_each_target([&](const char* name) {
    SCOPED_TRACE(name);
    Case a(13), b(13);
    for (const size_t i : {size_t{3}, size_t{100}, size_t{262}}) {
      a.d_texels[i] = 0.0f;
      b.d_texels[i] = i == 100 ? std::numeric_limits<float>::quiet_NaN()
                               : std::numeric_limits<float>::infinity();
    }
    texture_step(a.parameters, a.activation, a.mask, a.settings, {}, {}, a.texture, a.d_texels);
    const TextureStep result =
        texture_step(b.parameters, b.activation, b.mask, b.settings, {}, {}, b.texture, b.d_texels);
    EXPECT_EQ(result.not_finite, 3u);
    EXPECT_EQ(a.parameters.raw, b.parameters.raw);
  });
}

TEST(TextureLosses, OutsideRestsAtItsInitialValues) {
  Case c(15);
  c.settings = TextureLossSettings{};
  c.parameters = make_texture_parameters(c.mask, c.activation, {}, c.settings.outside);
  activate_texture(c.parameters, c.activation, c.texture);
  std::fill(c.d_texels.begin(), c.d_texels.end(), 0.0f);
  const std::vector<float> before = c.parameters.raw;
  const TextureStep result =
      texture_step(c.parameters, c.activation, c.mask, c.settings, {}, {}, c.texture, c.d_texels);
  EXPECT_EQ(result.losses.boundary, 0.0);
  EXPECT_EQ(c.parameters.raw, before);
  // A texel outside that was pushed away comes back.
  ASSERT_EQ(c.inside[0], 0);
  c.parameters.raw[0] = 1.0f;
  activate_texture(c.parameters, c.activation, c.texture);
  const float start = c.texture.texels[0];
  texture_step(c.parameters, c.activation, c.mask, c.settings, {}, {}, c.texture, c.d_texels);
  EXPECT_LT(c.texture.texels[0], start);
}

// Skipping the runs that rest is exact, also when a gradient arrives later or the loss changes.
TEST(TextureLosses, RestingRunsChangeNoBit) {
  for_each_target([&](const char* name) {
    SCOPED_TRACE(name);
    Case a(21, 200, 9);
    a.settings = TextureLossSettings{};
    a.parameters = make_texture_parameters(a.mask, a.activation, {}, a.settings.outside);
    activate_texture(a.parameters, a.activation, a.texture);
    Case b = a;
    for (int i = 0; i < 12; ++i) {
      for (Case* c : {&a, &b}) {
        std::fill(c->d_texels.begin(), c->d_texels.end(), 0.0f);
        for (size_t k = 0; k < c->inside.size(); k += 3)
          if (c->inside[k]) c->d_texels[8 * k] = 1e-3f;
        if (i >= 4 && i < 6) c->d_texels[8 * 190 + 8 * 200 * 7 + 3] = 2e-3f;  // outside
        if (i == 4) c->d_texels[8 * 190 + 8 * 200 * 8 + 6] = -2e-3f;
        if (i >= 10) c->settings.outside.roughness = 0.4f;
      }
      b.parameters.resting.clear();
      const TextureStep x = texture_step(a.parameters, a.activation, a.mask, a.settings, {}, {},
                                         a.texture, a.d_texels);
      const TextureStep y = texture_step(b.parameters, b.activation, b.mask, b.settings, {}, {},
                                         b.texture, b.d_texels);
      ASSERT_EQ(a.parameters.raw, b.parameters.raw) << i;
      ASSERT_EQ(a.parameters.adam.m, b.parameters.adam.m) << i;
      ASSERT_EQ(a.texture.texels, b.texture.texels) << i;
      ASSERT_EQ(x.losses.total(a.settings), y.losses.total(b.settings)) << i;
      const auto resting = std::count(a.parameters.resting.begin(), a.parameters.resting.end(), 1);
      if (i == 3) {
        EXPECT_GT(resting, 4);
      }
      if (i == 11) {
        EXPECT_EQ(resting, 0);
      }
    }
    for (const float value : a.d_texels) ASSERT_EQ(value, 0.0f);
  });
}

TEST(TextureLosses, ThreadCountDoesNotChangeBits) {
  const int before = thread_count();
  std::vector<float> first;
  TextureLosses first_losses;
  for (const int threads : {1, 2}) {
    set_thread_count(threads);
    Case c(17);
    const std::vector<float> d_texels = c.d_texels;
    TextureStep result;
    for (int i = 0; i < 4; ++i) {
      c.d_texels = d_texels;
      result = texture_step(c.parameters, c.activation, c.mask, c.settings, {}, {}, c.texture,
                            c.d_texels);
    }
    if (threads == 1) {
      first = c.parameters.raw;
      first_losses = result.losses;
    }
    EXPECT_EQ(c.parameters.raw, first);
    EXPECT_EQ(result.losses.total(c.settings), first_losses.total(c.settings));
  }
  set_thread_count(before);
}

TEST(TextureLosses, CheckpointGoesOnBitForBit) {
  Case c(19);
  const std::vector<float> d_texels = c.d_texels;
  texture_step(c.parameters, c.activation, c.mask, c.settings, {}, {}, c.texture, c.d_texels);
  TensorFile file;
  save_texture(c.parameters, "texture", file);
  const Path path = Path(testing::TempDir()) / "effigy_texture.safetensors";
  write_safetensors(path, file);
  TextureParameters loaded = load_texture(read_safetensors(path), "texture");
  std::filesystem::remove(path);
  MaterialTexture texture;
  activate_texture(loaded, c.activation, texture);
  std::vector<float> d = d_texels;
  c.d_texels = d_texels;
  texture_step(c.parameters, c.activation, c.mask, c.settings, {}, {}, c.texture, c.d_texels);
  texture_step(loaded, c.activation, c.mask, c.settings, {}, {}, texture, d);
  EXPECT_EQ(loaded.raw, c.parameters.raw);
  EXPECT_EQ(texture.texels, c.texture.texels);
  file.tensors.erase("texture.v");
  EXPECT_THROW(load_texture(file, "texture"), Error);
}

TEST(UvMask, RowOrderAndNeighbours) {
  const std::vector<uint8_t> rows{1, 1, 0,  //
                                  0, 1, 0};
  const UvMask mask(rows, 3, 2);
  EXPECT_EQ(mask.inside(), 3u);
  EXPECT_EQ(mask.outside(), 3u);
  EXPECT_EQ(mask.flags(), (std::vector<uint8_t>{1 | 2, 1 | 4 | 8, 0, 0, 1 | 16, 0}));
  const UvMask flipped(rows, 3, 2, true);
  EXPECT_EQ(flipped.flags(), (std::vector<uint8_t>{0, 1 | 8, 0, 1 | 2, 1 | 4 | 16, 0}));
}

TEST(TextureLosses, Speed) {
  const int size = 1024;
  std::vector<uint8_t> inside(static_cast<size_t>(size) * size);
  for (int y = 0; y < size; ++y)
    for (int x = 0; x < size; ++x)
      inside[static_cast<size_t>(y) * size + x] = std::hypot(x - 512, y - 512) < 460;
  const UvMask mask(inside, size, size);
  const TextureActivation activation;
  const TextureLossSettings settings;
  TextureParameters p = make_texture_parameters(mask, activation, {}, settings.outside);
  MaterialTexture texture;
  activate_texture(p, activation, texture);
  std::vector<float> d(p.raw.size());
  double best = 1e9, best_activate = 1e9;
  Random random(1);
  for (int i = 0; i < 6; ++i) {
    for (size_t k = 0; k < d.size(); k += 3)
      if (inside[k / 8]) d[k] = 1e-4f * static_cast<float>(random.uniform() - 0.5);
    auto start = std::chrono::steady_clock::now();
    texture_step(p, activation, mask, settings, {}, {}, texture, d);
    const std::chrono::duration<double> step = std::chrono::steady_clock::now() - start;
    start = std::chrono::steady_clock::now();
    activate_texture(p, activation, texture);
    const std::chrono::duration<double> activate = std::chrono::steady_clock::now() - start;
    best = std::min(best, step.count());
    best_activate = std::min(best_activate, activate.count());
  }
  std::printf("texture step 1024x1024: %.2f ms, activation alone %.2f ms\n", best * 1e3,
              best_activate * 1e3);
  EXPECT_LT(best, 1.0);
}

}  // namespace
}  // namespace effigy
