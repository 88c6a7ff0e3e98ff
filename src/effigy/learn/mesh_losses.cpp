#include "effigy/learn/mesh_losses.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "effigy/learn/mesh_losses.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

// Distances run over whole blendshape bases (millions of entries) every iteration.
HWY_BEFORE_NAMESPACE();
namespace effigy::HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// Sum of squared differences; adds scale * 2 (value - reference) to d_value unless null.
double squared_block(const float* value, const float* reference, float* d_value, size_t count,
                     float scale) {
  const hn::ScalableTag<float> d;
  const auto twice = hn::Set(d, 2.0f * scale);
  auto sum = hn::Zero(d);
  size_t i = 0;
  for (; i + hn::Lanes(d) <= count; i += hn::Lanes(d)) {
    const auto difference = hn::Sub(hn::LoadU(d, value + i), hn::LoadU(d, reference + i));
    sum = hn::MulAdd(difference, difference, sum);
    if (d_value != nullptr)
      hn::StoreU(hn::MulAdd(twice, difference, hn::LoadU(d, d_value + i)), d, d_value + i);
  }
  double total = static_cast<double>(hn::GetLane(hn::SumOfLanes(d, sum)));
  for (; i < count; ++i) {
    const float difference = value[i] - reference[i];
    total += static_cast<double>(difference) * difference;
    if (d_value != nullptr) d_value[i] += 2.0f * scale * difference;
  }
  return total;
}

// Sum of lengths of the differences of rows of three; adds scale times the unit difference.
// Returns how many rows it did; the caller does the rest.
size_t norm_block(const float* value, const float* reference, float* d_value, size_t rows,
                  float scale, double* total) {
  const hn::ScalableTag<float> d;
  auto sum = hn::Zero(d);
  size_t row = 0;
  for (; row + hn::Lanes(d) <= rows; row += hn::Lanes(d)) {
    auto x = hn::Zero(d), y = x, z = x, rx = x, ry = x, rz = x;
    hn::LoadInterleaved3(d, value + 3 * row, x, y, z);
    hn::LoadInterleaved3(d, reference + 3 * row, rx, ry, rz);
    x = hn::Sub(x, rx), y = hn::Sub(y, ry), z = hn::Sub(z, rz);
    const auto squares = hn::MulAdd(x, x, hn::MulAdd(y, y, hn::Mul(z, z)));
    const auto norm = hn::Sqrt(squares);
    sum = hn::Add(sum, norm);
    if (d_value == nullptr) continue;
    const auto factor =
        hn::IfThenElseZero(hn::Gt(norm, hn::Zero(d)), hn::Div(hn::Set(d, scale), norm));
    auto gx = rx, gy = ry, gz = rz;
    hn::LoadInterleaved3(d, d_value + 3 * row, gx, gy, gz);
    hn::StoreInterleaved3(hn::MulAdd(factor, x, gx), hn::MulAdd(factor, y, gy),
                          hn::MulAdd(factor, z, gz), d, d_value + 3 * row);
  }
  *total = static_cast<double>(hn::GetLane(hn::SumOfLanes(d, sum)));
  return row;
}

}  // namespace effigy::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace effigy {
namespace {

HWY_EXPORT(squared_block);
HWY_EXPORT(norm_block);

// Rows summed together, so that sums do not depend on the thread count.
constexpr size_t kBlock = 4096;

template <typename Body>
double sum_blocks(size_t count, const Body& body) {
  const size_t blocks = (count + kBlock - 1) / kBlock;
  std::vector<double> parts(blocks);
  parallel_for(blocks, 1, [&](size_t begin, size_t end, int) {
    for (size_t b = begin; b < end; ++b)
      parts[b] = body(b * kBlock, std::min(count, (b + 1) * kBlock));
  });
  double sum = 0;
  for (const double part : parts) sum += part;
  return sum;
}

}  // namespace

double laplacian_loss(const UniformLaplacian& laplacian, std::span<const float> tuned,
                      std::span<const float> original, float weight, std::span<float> d_tuned,
                      std::vector<float>& scratch) {
  const size_t floats = 3 * static_cast<size_t>(laplacian.vertex_count());
  EFFIGY_CHECK_EQ(tuned.size(), floats);
  EFFIGY_CHECK_EQ(original.size(), floats);
  EFFIGY_CHECK(d_tuned.empty() || d_tuned.size() == floats);
  if (floats == 0) return 0.0;
  scratch.resize(2 * floats);
  const std::span<float> offset(scratch.data(), floats), curvature(scratch.data() + floats, floats);
  for (size_t i = 0; i < floats; ++i) offset[i] = tuned[i] - original[i];
  laplacian.apply(offset, curvature);
  const double vertices = static_cast<double>(laplacian.vertex_count());
  double sum = 0;
  for (const float value : curvature) sum += static_cast<double>(value) * value;
  if (!d_tuned.empty()) {
    // d |L x|^2 / dx = 2 L^T L x.
    laplacian.apply_transpose(curvature, offset);
    const float scale = static_cast<float>(2.0 * weight / vertices);
    for (size_t i = 0; i < floats; ++i) d_tuned[i] += scale * offset[i];
  }
  return sum / vertices;
}

double barycentric_loss(std::span<const float> barycentric, float weight,
                        std::span<float> d_barycentric) {
  EFFIGY_CHECK(barycentric.size() % 2 == 0);
  EFFIGY_CHECK(d_barycentric.empty() || d_barycentric.size() == barycentric.size());
  const size_t count = barycentric.size() / 2;
  if (count == 0) return 0.0;
  constexpr double kThird = 1.0 / 3.0;
  const double scale = 2.0 * weight / static_cast<double>(count);
  const double sum = sum_blocks(count, [&](size_t begin, size_t end) {
    double part = 0;
    for (size_t i = begin; i < end; ++i) {
      const double b = barycentric[2 * i] - kThird, c = barycentric[2 * i + 1] - kThird;
      const double a = -b - c;  // of the first coordinate, 1 - b - c
      part += a * a + b * b + c * c;
      if (d_barycentric.empty()) continue;
      d_barycentric[2 * i] += static_cast<float>(scale * (b - a));
      d_barycentric[2 * i + 1] += static_cast<float>(scale * (c - a));
    }
    return part;
  });
  return sum / static_cast<double>(count);
}

double distance_loss(std::span<const float> value, std::span<const float> reference,
                     Distance distance, size_t width, float weight, std::span<float> d_value) {
  EFFIGY_CHECK_EQ(value.size(), reference.size());
  EFFIGY_CHECK(d_value.empty() || d_value.size() == value.size());
  EFFIGY_CHECK(width > 0 && value.size() % width == 0);
  if (value.empty()) return 0.0;
  float* const gradient = d_value.empty() ? nullptr : d_value.data();
  if (distance == Distance::kMeanSquared) {
    const double count = static_cast<double>(value.size());
    const float scale = static_cast<float>(weight / count);
    const double sum = sum_blocks(value.size(), [&](size_t begin, size_t end) {
      return HWY_DYNAMIC_DISPATCH(squared_block)(value.data() + begin, reference.data() + begin,
                                                 gradient == nullptr ? nullptr : gradient + begin,
                                                 end - begin, scale);
    });
    return sum / count;
  }
  const size_t rows = value.size() / width;
  const double scale = weight / static_cast<double>(rows);
  const double sum = sum_blocks(rows, [&](size_t begin, size_t end) {
    double part = 0;
    size_t row = begin;
    if (width == 3)
      row +=
          HWY_DYNAMIC_DISPATCH(norm_block)(value.data() + 3 * begin, reference.data() + 3 * begin,
                                           gradient == nullptr ? nullptr : gradient + 3 * begin,
                                           end - begin, static_cast<float>(scale), &part);
    for (; row < end; ++row) {
      const size_t at = row * width;
      double squares = 0;
      for (size_t k = 0; k < width; ++k) {
        const double difference = static_cast<double>(value[at + k]) - reference[at + k];
        squares += difference * difference;
      }
      const double norm = std::sqrt(squares);
      part += norm;
      if (gradient == nullptr || norm == 0.0) continue;
      for (size_t k = 0; k < width; ++k)
        gradient[at + k] += static_cast<float>(
            scale / norm * (static_cast<double>(value[at + k]) - reference[at + k]));
    }
    return part;
  });
  return sum / static_cast<double>(rows);
}

}  // namespace effigy
#endif  // HWY_ONCE
