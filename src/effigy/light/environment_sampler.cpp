#include "effigy/light/environment_sampler.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "effigy/base/error.h"
#include "effigy/image/colour.h"

namespace effigy {
namespace {

constexpr double kPi = std::numbers::pi;

double row_height(int row, int height) {  // d(cos theta)
  return std::cos(kPi * row / height) - std::cos(kPi * (row + 1) / height);
}

}  // namespace

EnvironmentSampler::EnvironmentSampler(const Cubemap& radiance, EnvironmentDraw draw)
    : EnvironmentSampler(
          equirectangular_from_cubemap(radiance, 4 * radiance.size, 2 * radiance.size), 0.0, draw) {
}

EnvironmentSampler::EnvironmentSampler(const Image& image, double rotation, EnvironmentDraw draw)
    : width_(image.width),
      height_(image.height),
      draw_(draw),
      rotation_(static_cast<float>(rotation)) {
  EFFIGY_CHECK(width_ >= 2 && height_ >= 1 && image.channels == 3);
  texels_.resize(static_cast<size_t>(width_) * height_);
  for (int y = 0; y < height_; ++y) {
    const double solid_angle = 2 * kPi / width_ * row_height(y, height_);
    for (int x = 0; x < width_; ++x) {
      const size_t i = static_cast<size_t>(y) * width_ + x;
      texels_[i] = Vec3f(image.at(x, y));
      flux_ += solid_angle * texels_[i].cast<double>();
    }
  }
  floor_ = static_cast<float>(flux_.mean() / (4 * kPi) * (1 + 1e-5));
  columns_.resize(height_);
  row_cosine_.resize(static_cast<size_t>(height_) + 1);
  std::vector<double> row_sum(height_), weights(width_);
  for (int y = 0; y < height_; ++y) {
    row_cosine_[y] = static_cast<float>(std::cos(kPi * y / height_));
    const double solid_angle = 2 * kPi / width_ * row_height(y, height_);
    for (int x = 0; x < width_; ++x) {
      weights[x] = solid_angle * brightness(static_cast<size_t>(y) * width_ + x);
      row_sum[y] += weights[x];
    }
    total_ += row_sum[y];
    if (row_sum[y] > 0) columns_[y].build(weights);
  }
  row_cosine_.back() = -1;
  if (total_ > 0) rows_.build(row_sum);
}

void EnvironmentSampler::Table::build(const std::vector<double>& weights) {
  const size_t cells = weights.size();
  cumulative_.assign(cells + 1, 0.0f);
  double total = 0, sum = 0;
  for (const double weight : weights) total += weight;
  for (size_t i = 0; i < cells; ++i) {
    sum += weights[i];
    cumulative_[i + 1] = static_cast<float>(sum / total);
  }
  // Beyond the last cell with weight there is nothing to find, whatever the rounding.
  for (size_t i = cells; i > 0 && cumulative_[i] >= cumulative_[cells]; --i) cumulative_[i] = 1;
  guide_.resize(cells);
  size_t cell = 0;
  for (size_t k = 0; k < cells; ++k) {
    while (cumulative_[cell + 1] <= static_cast<float>(k) / static_cast<float>(cells)) ++cell;
    guide_[k] = static_cast<int>(cell);
  }
}

int EnvironmentSampler::Table::find(float u, float& place) const {
  const auto cells = static_cast<float>(guide_.size());
  size_t cell = guide_[std::min(static_cast<size_t>(u * cells), guide_.size() - 1)];
  while (cumulative_[cell + 1] <= u) ++cell;
  const float low = cumulative_[cell], width = cumulative_[cell + 1] - low;
  place = std::clamp((u - low) / width, 0.0f, 1.0f);
  return static_cast<int>(cell);
}

float EnvironmentSampler::brightness(size_t i) const {
  const Vec3f& t = texels_[i];
  if (draw_ == EnvironmentDraw::kLuminance) return luminance(t.x(), t.y(), t.z());
  return std::max(t.mean() - floor_, 0.0f);
}

EnvironmentSampler::Sample EnvironmentSampler::sample(const Vec2f& u) const {
  Sample sample{Vec3f::UnitY(), Vec3f::Zero(), 0};
  if (total_ <= 0) return sample;
  float down = 0, along = 0;
  const int row = rows_.find(u.y(), down), column = columns_[row].find(u.x(), along);
  const size_t i = static_cast<size_t>(row) * width_ + column;
  const float top = row_cosine_[row], bottom = row_cosine_[row + 1];
  const float y = top + down * (bottom - top), r = std::sqrt(std::max(0.0f, 1.0f - y * y));
  const float longitude =
      static_cast<float>(2 * kPi) * ((static_cast<float>(column) + along) / width_ - 0.5f) -
      rotation_;
  sample.direction = Vec3f(r * std::sin(longitude), y, -r * std::cos(longitude));
  sample.radiance = texels_[i];
  sample.density = brightness(i) / static_cast<float>(total_);
  return sample;
}

size_t EnvironmentSampler::pixel(const Vec3f& d) const {
  float u = (std::atan2(d.x(), -d.z()) + rotation_) * static_cast<float>(0.5 / kPi) + 0.5f;
  u -= std::floor(u);
  const float v = std::acos(std::clamp(d.y(), -1.0f, 1.0f)) * static_cast<float>(1.0 / kPi);
  const int x = std::min(static_cast<int>(u * width_), width_ - 1);
  const int y = std::min(static_cast<int>(v * height_), height_ - 1);
  return static_cast<size_t>(y) * width_ + x;
}

Vec3f EnvironmentSampler::radiance(const Vec3f& direction, float& density) const {
  const size_t i = pixel(direction);
  density = total_ > 0 ? brightness(i) / static_cast<float>(total_) : 0.0f;
  return texels_[i];
}

}  // namespace effigy
