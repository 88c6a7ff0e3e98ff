#include "effigy/geometry/laplacian.h"

#include "effigy/base/error.h"
#include "effigy/geometry/mesh.h"

namespace effigy {

UniformLaplacian::UniformLaplacian(const std::vector<Vec3i>& triangles, int vertex_count) {
  EFFIGY_CHECK(vertex_count >= 0);
  const auto edges = mesh_edges(triangles, vertex_count);
  const size_t vertices = static_cast<size_t>(vertex_count);
  starts_.assign(vertices + 1, 0);
  for (const auto& [a, b] : edges) {
    ++starts_[static_cast<size_t>(a) + 1];
    ++starts_[static_cast<size_t>(b) + 1];
  }
  for (size_t v = 0; v < vertices; ++v) {
    inverse_valence_.push_back(starts_[v + 1] > 0 ? 1.0f / static_cast<float>(starts_[v + 1]) : 0);
    starts_[v + 1] += starts_[v];
  }
  neighbours_.resize(2 * edges.size());
  std::vector<int> next(starts_.begin(), starts_.end() - 1);
  // Edges are sorted by (a, b) with a < b. Filling in all smaller neighbours first, then all larger
  // ones keeps each list ascending.
  for (const auto& [a, b] : edges)
    neighbours_[static_cast<size_t>(next[static_cast<size_t>(b)]++)] = a;
  for (const auto& [a, b] : edges)
    neighbours_[static_cast<size_t>(next[static_cast<size_t>(a)]++)] = b;
}

std::span<const int> UniformLaplacian::neighbours(int vertex) const {
  EFFIGY_CHECK(vertex >= 0 && vertex < vertex_count());
  const size_t v = static_cast<size_t>(vertex);
  return std::span<const int>(neighbours_)
      .subspan(static_cast<size_t>(starts_[v]), static_cast<size_t>(starts_[v + 1] - starts_[v]));
}

void UniformLaplacian::apply(std::span<const float> x, std::span<float> out) const {
  const size_t vertices = inverse_valence_.size();
  EFFIGY_CHECK_EQ(x.size(), 3 * vertices);
  EFFIGY_CHECK_EQ(out.size(), 3 * vertices);
  for (size_t v = 0; v < vertices; ++v) {
    float sum[3] = {};
    for (int i = starts_[v]; i < starts_[v + 1]; ++i) {
      const float* p = x.data() + 3 * static_cast<size_t>(neighbours_[static_cast<size_t>(i)]);
      for (size_t axis = 0; axis < 3; ++axis) sum[axis] += p[axis];
    }
    const float scale = inverse_valence_[v];
    for (size_t axis = 0; axis < 3; ++axis)
      out[3 * v + axis] = scale > 0 ? x[3 * v + axis] - scale * sum[axis] : 0;
  }
}

// Neighbourhood is symmetric, so column i of L has the entries -1/valence_j for the neighbours j
// of i.
void UniformLaplacian::apply_transpose(std::span<const float> y, std::span<float> out) const {
  const size_t vertices = inverse_valence_.size();
  EFFIGY_CHECK_EQ(y.size(), 3 * vertices);
  EFFIGY_CHECK_EQ(out.size(), 3 * vertices);
  for (size_t v = 0; v < vertices; ++v) {
    float sum[3] = {};
    for (int i = starts_[v]; i < starts_[v + 1]; ++i) {
      const size_t j = static_cast<size_t>(neighbours_[static_cast<size_t>(i)]);
      for (size_t axis = 0; axis < 3; ++axis) sum[axis] += inverse_valence_[j] * y[3 * j + axis];
    }
    for (size_t axis = 0; axis < 3; ++axis)
      out[3 * v + axis] = inverse_valence_[v] > 0 ? y[3 * v + axis] - sum[axis] : 0;
  }
}

}  // namespace effigy
