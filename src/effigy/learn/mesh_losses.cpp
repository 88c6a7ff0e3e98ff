#include "effigy/learn/mesh_losses.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"

namespace effigy {
namespace {

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
  const size_t rows = value.size() / width;
  const bool squared = distance == Distance::kMeanSquared;
  const double count = static_cast<double>(squared ? value.size() : rows);
  const double sum = sum_blocks(rows, [&](size_t begin, size_t end) {
    double part = 0;
    for (size_t row = begin; row < end; ++row) {
      const size_t at = row * width;
      double squares = 0;
      for (size_t k = 0; k < width; ++k) {
        const double difference = static_cast<double>(value[at + k]) - reference[at + k];
        squares += difference * difference;
      }
      const double norm = std::sqrt(squares);
      part += squared ? squares : norm;
      if (d_value.empty() || squares == 0.0) continue;
      const double scale = weight / count * (squared ? 2.0 : 1.0 / norm);
      for (size_t k = 0; k < width; ++k)
        d_value[at + k] +=
            static_cast<float>(scale * (static_cast<double>(value[at + k]) - reference[at + k]));
    }
    return part;
  });
  return sum / count;
}

}  // namespace effigy
