#include "effigy/learn/texture_losses.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/learn/texture_kernel.h"

namespace effigy {
namespace {

using texture_kernel::Row;
using texture_kernel::Sums;
using KernelSettings = texture_kernel::Settings;

constexpr size_t kAlbedo = 0, kRoughnessLane = 3, kSpecularLane = 4, kNormalLane = 5;

KernelSettings activation_settings(const TextureActivation& activation) {
  EFFIGY_CHECK(activation.roughness_low < activation.roughness_high);
  EFFIGY_CHECK(activation.specular_low < activation.specular_high);
  EFFIGY_CHECK(activation.normal_limit > 0.0f && activation.normal_limit < 1.0f);
  KernelSettings kernel{};
  auto& lanes = kernel.lanes;
  const auto lane = [&](size_t k, float low, float high, float slope) {
    lanes.low[k] = low;
    lanes.range[k] = high - low;
    lanes.inverse_range[k] = 1.0f / (high - low);
    lanes.slope[k] = slope;
  };
  for (size_t k = kAlbedo; k < kAlbedo + 3; ++k) lane(k, 0.0f, 1.0f, 1.0f);
  lane(kRoughnessLane, activation.roughness_low, activation.roughness_high, 1.0f);
  lane(kSpecularLane, activation.specular_low, activation.specular_high, 1.0f);
  for (size_t k = kNormalLane; k < kNormalLane + 2; ++k) {
    lane(k, -1.0f, 1.0f, 2.0f);  // tanh(x) = 2 sigmoid(2 x) - 1
    lanes.is_normal[k] = 1.0f;
  }
  kernel.normal_limit = activation.normal_limit;
  return kernel;
}

void add_losses(const TextureLossSettings& settings, const UvMask& mask, KernelSettings& kernel) {
  const float inside = 1.0f / static_cast<float>(std::max<size_t>(1, mask.inside()));
  const float outside = 1.0f / static_cast<float>(std::max<size_t>(1, mask.outside()));
  auto& lanes = kernel.lanes;
  for (size_t k = kAlbedo; k < kAlbedo + 3; ++k) {
    lanes.tv[k] = settings.albedo_tv * inside / 3.0f;
    lanes.albedo_prior[k] = settings.albedo_prior * inside;
    lanes.boundary_target[k] = settings.outside.albedo[k];
  }
  lanes.tv[kRoughnessLane] = settings.roughness_tv * inside;
  lanes.tv[kSpecularLane] = settings.specular_tv * inside;
  // Derivative of the square included.
  lanes.prior[kRoughnessLane] = 2.0f * settings.roughness_prior * inside;
  lanes.prior[kSpecularLane] = 2.0f * settings.specular_prior * inside;
  lanes.prior_target[kRoughnessLane] = settings.roughness_target;
  lanes.prior_target[kSpecularLane] = settings.specular_target;
  lanes.boundary_target[kRoughnessLane] = settings.outside.roughness;
  lanes.boundary_target[kSpecularLane] = settings.outside.specular;
  for (size_t k = 0; k < 7; ++k) lanes.boundary[k] = settings.boundary * outside;
  for (size_t k = kNormalLane; k < kNormalLane + 2; ++k) lanes.normal[k] = settings.normal * inside;
  kernel.boundary_tolerance = settings.boundary_tolerance;
  kernel.tv = settings.roughness_tv != 0 || settings.specular_tv != 0 || settings.albedo_tv != 0;
  kernel.tv_squared = settings.tv_squared;
  kernel.prior = settings.roughness_prior != 0 || settings.specular_prior != 0 ||
                 settings.albedo_target != nullptr;
}

void wake_up_when_changed(const TextureLossSettings& settings, size_t runs,
                          TextureParameters& parameters) {
  const TexelValue& outside = settings.outside;
  const std::array<float, 7> under{outside.albedo[0],          outside.albedo[1], outside.albedo[2],
                                   outside.roughness,          outside.specular,  settings.boundary,
                                   settings.boundary_tolerance};
  if (parameters.resting.size() == runs && parameters.resting_under == under) return;
  parameters.resting.assign(runs, 0);
  parameters.resting_under = under;
}

// Row sums in order of rows, so that they do not depend on the thread count.
TextureStep collect(const std::vector<Sums>& rows, const UvMask& mask) {
  double tv[8] = {}, normal[8] = {}, prior[8] = {}, albedo_prior[8] = {}, boundary[8] = {};
  TextureStep result;
  for (const Sums& row : rows) {
    for (int k = 0; k < 8; ++k) {
      tv[k] += row.tv[k];
      normal[k] += row.normal[k];
      prior[k] += row.prior[k];
      albedo_prior[k] += row.albedo_prior[k];
      boundary[k] += row.boundary[k];
    }
    result.not_finite += row.not_finite;
  }
  const double inside = 1.0 / static_cast<double>(std::max<size_t>(1, mask.inside()));
  const double outside = 1.0 / static_cast<double>(std::max<size_t>(1, mask.outside()));
  TextureLosses& losses = result.losses;
  losses.albedo_tv = (tv[0] + tv[1] + tv[2]) * inside / 3.0;
  losses.roughness_tv = tv[kRoughnessLane] * inside;
  losses.specular_tv = tv[kSpecularLane] * inside;
  losses.normal = (normal[kNormalLane] + normal[kNormalLane + 1]) * inside;
  losses.roughness_prior = prior[kRoughnessLane] * inside;
  losses.specular_prior = prior[kSpecularLane] * inside;
  losses.albedo_prior = (albedo_prior[0] + albedo_prior[1] + albedo_prior[2]) * inside;
  for (size_t k = 0; k < 7; ++k) losses.boundary += boundary[k] * outside;
  return result;
}

void check_sizes(const TextureParameters& parameters, const UvMask& mask,
                 const TextureLossSettings& settings, const MaterialTexture& texture) {
  const int width = parameters.width, height = parameters.height;
  EFFIGY_CHECK(width > 0 && height > 0);
  const size_t floats = static_cast<size_t>(width) * static_cast<size_t>(height) * kTexelFloats;
  EFFIGY_CHECK(mask.width() == width && mask.height() == height);
  EFFIGY_CHECK(texture.width == width && texture.height == height);
  EFFIGY_CHECK_EQ(texture.texels.size(), floats);
  EFFIGY_CHECK_EQ(parameters.raw.size(), floats);
  if (settings.albedo_target != nullptr)
    EFFIGY_CHECK_EQ(settings.albedo_target->texels.size(), floats);
}

float logit(float value, float low, float high) {
  const double t = std::clamp((static_cast<double>(value) - low) / (high - low), 1e-4, 1.0 - 1e-4);
  return static_cast<float>(std::log(t / (1.0 - t)));
}

// `value`: the 7 used floats of a texel.
void inverse_activation(const float* value, const TextureActivation& activation, float* raw) {
  for (size_t k = kAlbedo; k < kAlbedo + 3; ++k) raw[k] = logit(value[k], 0.0f, 1.0f);
  raw[kRoughnessLane] =
      logit(value[kRoughnessLane], activation.roughness_low, activation.roughness_high);
  raw[kSpecularLane] =
      logit(value[kSpecularLane], activation.specular_low, activation.specular_high);
  const double x = value[kNormalLane], y = value[kNormalLane + 1];
  const double length = std::sqrt(x * x + y * y);
  const double limit = activation.normal_limit * (1.0 - 1e-4);
  const double scale = length > limit ? limit / length : 1.0;
  raw[kNormalLane] = static_cast<float>(std::atanh(x * scale));
  raw[kNormalLane + 1] = static_cast<float>(std::atanh(y * scale));
  raw[kTexelFloats - 1] = 0.0f;
}

TextureParameters sized_parameters(int width, int height) {
  EFFIGY_CHECK(width > 0 && height > 0);
  TextureParameters parameters;
  parameters.width = width;
  parameters.height = height;
  const size_t floats = static_cast<size_t>(width) * static_cast<size_t>(height) * kTexelFloats;
  parameters.raw.resize(floats);
  parameters.adam = AdamState(floats);
  return parameters;
}

}  // namespace

UvMask::UvMask(std::span<const uint8_t> inside, int width, int height, bool top_row_first)
    : width_(width), height_(height) {
  EFFIGY_CHECK(width > 0 && height > 0);
  EFFIGY_CHECK_EQ(inside.size(), static_cast<size_t>(width) * static_cast<size_t>(height));
  const auto at = [&](int x, int y) {
    if (x < 0 || y < 0 || x >= width || y >= height) return false;
    const int row = top_row_first ? height - 1 - y : y;
    return inside[static_cast<size_t>(row) * static_cast<size_t>(width) + static_cast<size_t>(x)] !=
           0;
  };
  flags_.resize(inside.size());
  size_t i = 0;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x, ++i) {
      if (!at(x, y)) continue;
      ++inside_;
      flags_[i] = static_cast<uint8_t>(1 | (at(x + 1, y) ? 2 : 0) | (at(x - 1, y) ? 4 : 0) |
                                       (at(x, y + 1) ? 8 : 0) | (at(x, y - 1) ? 16 : 0));
    }
  constexpr int kRun = static_cast<int>(texture_kernel::kRun);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; x += kRun) {
      const uint8_t* const flags =
          flags_.data() + static_cast<size_t>(y) * static_cast<size_t>(width) + x;
      const int count = std::min(kRun, width - x);
      const bool interior =
          count == kRun && std::all_of(flags, flags + count, [](uint8_t f) { return f == 31; });
      const bool outside = std::all_of(flags, flags + count, [](uint8_t f) { return f == 0; });
      runs_.push_back(interior  ? texture_kernel::kInterior
                      : outside ? texture_kernel::kOutside
                                : texture_kernel::kMixed);
    }
}

double TextureLosses::total(const TextureLossSettings& s) const {
  return s.roughness_tv * roughness_tv + s.specular_tv * specular_tv + s.albedo_tv * albedo_tv +
         s.normal * normal + s.boundary * boundary + s.roughness_prior * roughness_prior +
         s.specular_prior * specular_prior + s.albedo_prior * albedo_prior;
}

TextureParameters make_texture_parameters(const UvMask& mask, const TextureActivation& activation,
                                          const TexelValue& inside, const TexelValue& outside) {
  TextureParameters parameters = sized_parameters(mask.width(), mask.height());
  float raw[2][kTexelFloats];
  const TexelValue* const values[2] = {&outside, &inside};
  for (size_t i = 0; i < 2; ++i) {
    const TexelValue& value = *values[i];
    const float texel[kTexelFloats] = {value.albedo[0], value.albedo[1], value.albedo[2],
                                       value.roughness, value.specular};
    inverse_activation(texel, activation, raw[i]);
  }
  for (size_t i = 0; i < mask.flags().size(); ++i)
    std::copy_n(raw[mask.flags()[i] & 1], kTexelFloats, parameters.raw.data() + i * kTexelFloats);
  return parameters;
}

TextureParameters texture_parameters_of(const MaterialTexture& texture,
                                        const TextureActivation& activation) {
  TextureParameters parameters = sized_parameters(texture.width, texture.height);
  EFFIGY_CHECK_EQ(texture.texels.size(), parameters.raw.size());
  const size_t texels = texture.texels.size() / kTexelFloats;
  parallel_for(texels, 4096, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i)
      inverse_activation(texture.texels.data() + i * kTexelFloats, activation,
                         parameters.raw.data() + i * kTexelFloats);
  });
  return parameters;
}

void activate_texture(const TextureParameters& parameters, const TextureActivation& activation,
                      MaterialTexture& texture) {
  const KernelSettings kernel = activation_settings(activation);
  texture.width = parameters.width;
  texture.height = parameters.height;
  texture.texels.resize(parameters.raw.size());
  parallel_for(parameters.raw.size() / kTexelFloats, 4096, [&](size_t begin, size_t end, int) {
    texture_kernel::activate(kernel, parameters.raw.data() + begin * kTexelFloats,
                             texture.texels.data() + begin * kTexelFloats, end - begin);
  });
}

void save_texture(const TextureParameters& parameters, const std::string& name, TensorFile& file) {
  file.tensors[name + ".raw"] =
      Tensor::from(std::span<const float>(parameters.raw),
                   {parameters.height, parameters.width, static_cast<int64_t>(kTexelFloats)});
  save_adam(parameters.adam, name, file);
}

TextureParameters load_texture(const TensorFile& file, const std::string& name) {
  TextureParameters parameters;
  parameters.raw = file.floats(name + ".raw", {-1, -1, static_cast<int64_t>(kTexelFloats)});
  const auto& shape = file.shape(name + ".raw");
  if (shape[0] < 1 || shape[1] < 1 || shape[0] > 16384 || shape[1] > 16384)
    throw Error(file.path.string() + ": '" + name +
                ".raw' is not a texture of 1 to 16384 texels a side; start the training anew.");
  parameters.height = static_cast<int>(shape[0]);
  parameters.width = static_cast<int>(shape[1]);
  parameters.adam = load_adam(file, name, parameters.raw.size());
  return parameters;
}

TextureStep texture_step(TextureParameters& parameters, const TextureActivation& activation,
                         const UvMask& mask, const TextureLossSettings& settings,
                         const TextureRates& rates, const AdamSettings& adam,
                         MaterialTexture& texture, std::span<float> d_texels) {
  check_sizes(parameters, mask, settings, texture);
  EFFIGY_CHECK_EQ(d_texels.size(), parameters.raw.size());
  EFFIGY_CHECK_EQ(parameters.adam.size(), parameters.raw.size());
  KernelSettings kernel = activation_settings(activation);
  add_losses(settings, mask, kernel);
  const AdamScale scale = adam_scale(adam, ++parameters.adam.step);
  const float rate[kTexelFloats] = {rates.albedo,   rates.albedo, rates.albedo, rates.roughness,
                                    rates.specular, rates.normal, rates.normal, 0.0f};
  for (size_t k = 0; k < kTexelFloats; ++k)
    kernel.lanes.rate[k] = static_cast<float>(rate[k] * scale.inverse_correction1);
  kernel.inverse_root = static_cast<float>(scale.inverse_root);
  kernel.beta1 = adam.beta1;
  kernel.beta2 = adam.beta2;
  kernel.epsilon = adam.epsilon;

  const size_t width = static_cast<size_t>(parameters.width);
  const size_t height = static_cast<size_t>(parameters.height);
  const size_t pitch = width * kTexelFloats, runs = mask.runs().size() / height;
  wake_up_when_changed(settings, mask.runs().size(), parameters);
  const size_t slots = std::min<size_t>(static_cast<size_t>(thread_count()), height);
  const auto first_row = [&](size_t slot) { return height * slot / slots; };
  // The texture is overwritten in place while neighbours' old values are still needed: a slot keeps
  // the old values of its last two rows, and those of the rows just outside its band are copied
  // before any slot starts.
  std::vector<float> borders(slots * 2 * pitch), lines(slots * 2 * pitch);
  for (size_t slot = 0; slot < slots; ++slot) {
    const size_t begin = first_row(slot), end = first_row(slot + 1);
    float* border = borders.data() + slot * 2 * pitch;
    if (begin > 0) std::copy_n(texture.texels.data() + (begin - 1) * pitch, pitch, border);
    if (end < height) std::copy_n(texture.texels.data() + end * pitch, pitch, border + pitch);
  }
  std::vector<Sums> sums(height);
  run_slots(static_cast<int>(slots), [&](int slot_index) {
    const size_t slot = static_cast<size_t>(slot_index);
    const size_t begin = first_row(slot), end = first_row(slot + 1);
    float* const line = lines.data() + slot * 2 * pitch;
    const float* const border = borders.data() + slot * 2 * pitch;
    for (size_t y = begin; y < end; ++y) {
      float* const texels = texture.texels.data() + y * pitch;
      float* const old = line + (y % 2) * pitch;
      Row row;
      row.width = width;
      row.flags = mask.flags().data() + y * width;
      row.kinds = mask.runs().data() + y * runs;
      row.texels = old;
      row.old = old;
      row.below = y == begin ? border : line + ((y + 1) % 2) * pitch;
      row.above = y + 1 == end ? border + pitch : texels + pitch;
      row.albedo_target = settings.albedo_target == nullptr
                              ? nullptr
                              : settings.albedo_target->texels.data() + y * pitch;
      row.new_raw = parameters.raw.data() + y * pitch;
      row.raw = row.new_raw;
      row.m = parameters.adam.m.data() + y * pitch;
      row.v = parameters.adam.v.data() + y * pitch;
      row.new_d_texels = d_texels.data() + y * pitch;
      row.d_texels = row.new_d_texels;
      row.out = texels;
      row.resting = parameters.resting.data() + y * runs;
      row.sums = &sums[y];
      texture_kernel::step_row(kernel, row);
    }
  });
  return collect(sums, mask);
}

TextureStep texture_gradient(const TextureParameters& parameters,
                             const TextureActivation& activation, const UvMask& mask,
                             const TextureLossSettings& settings, const MaterialTexture& texture,
                             std::span<const float> d_texels, std::span<float> d_raw) {
  check_sizes(parameters, mask, settings, texture);
  EFFIGY_CHECK_EQ(d_texels.size(), parameters.raw.size());
  EFFIGY_CHECK_EQ(d_raw.size(), parameters.raw.size());
  KernelSettings kernel = activation_settings(activation);
  add_losses(settings, mask, kernel);
  const size_t width = static_cast<size_t>(parameters.width);
  const size_t height = static_cast<size_t>(parameters.height);
  const size_t pitch = width * kTexelFloats, runs = mask.runs().size() / height;
  std::vector<Sums> sums(height);
  parallel_for(height, 8, [&](size_t begin, size_t end, int) {
    for (size_t y = begin; y < end; ++y) {
      Row row{};
      row.width = width;
      row.flags = mask.flags().data() + y * width;
      row.kinds = mask.runs().data() + y * runs;
      row.texels = texture.texels.data() + y * pitch;
      row.below = row.texels - (y == 0 ? 0 : pitch);
      row.above = row.texels + (y + 1 == height ? 0 : pitch);
      row.albedo_target = settings.albedo_target == nullptr
                              ? nullptr
                              : settings.albedo_target->texels.data() + y * pitch;
      row.raw = parameters.raw.data() + y * pitch;
      row.d_texels = d_texels.data() + y * pitch;
      row.out = d_raw.data() + y * pitch;
      row.sums = &sums[y];
      texture_kernel::gradient_row(kernel, row);
    }
  });
  return collect(sums, mask);
}

}  // namespace effigy
