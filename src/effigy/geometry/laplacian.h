// The uniform graph Laplacian of a mesh.
#pragma once

#include <span>
#include <vector>

#include "effigy/geometry/types.h"

namespace effigy {

// (L x)_i = x_i - mean of x over the neighbours of i; 0 for a vertex without neighbours. L is not
// symmetric (rows are divided by their own valence), so gradients need the transpose:
// for a loss f(L x), df/dx = L^T f'(L x).
class UniformLaplacian {
 public:
  UniformLaplacian() = default;
  UniformLaplacian(const std::vector<Vec3i>& triangles, int vertex_count);

  int vertex_count() const { return static_cast<int>(starts_.size()) - 1; }
  // Neighbours of a vertex, ascending.
  std::span<const int> neighbours(int vertex) const;

  // out = L x and out = L^T y; all 3 vertex_count() long, `out` apart from the input.
  void apply(std::span<const float> x, std::span<float> out) const;
  void apply_transpose(std::span<const float> y, std::span<float> out) const;

 private:
  std::vector<int> starts_{0};  // V + 1, into neighbours_
  std::vector<int> neighbours_;
  std::vector<float> inverse_valence_;  // 0 for a vertex without neighbours
};

}  // namespace effigy
