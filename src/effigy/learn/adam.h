// Adam (Kingma and Ba 2015) over plain float arrays, one fused pass, and what a training loop needs
// around it: checks of gradients, and a state that a checkpoint keeps bit for bit.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "effigy/base/safetensors.h"

namespace effigy {

struct AdamSettings {
  float beta1 = 0.9f, beta2 = 0.999f;
  float epsilon = 1e-15f;  // 3DGS practice; Kingma and Ba use 1e-8
};

// First and second moments of the gradient, and how many steps were made.
struct AdamState {
  std::vector<float> m, v;
  int64_t step = 0;

  explicit AdamState(size_t count = 0) : m(count), v(count) {}
  size_t size() const { return m.size(); }
  // Rearranges after parameters were added, removed or reordered: the new row i (of `width` floats)
  // takes the moments of the old row source[i], or starts at zero where source[i] is -1.
  void rearrange(std::span<const int32_t> source, size_t width);
};

// The numbers of one step that depend on the step count, computed in double precision:
//   p -= rate m / (sqrt(v) inverse_root + epsilon),
//   rate = lr / (1 - beta1^t), inverse_root = 1 / sqrt(1 - beta2^t).
struct AdamScale {
  double inverse_correction1 = 1, inverse_root = 1;
};
AdamScale adam_scale(const AdamSettings& settings, int64_t step);

// One step on `parameters` with learning rate `lr`; all spans and the state have the same length.
// Increments state.step. A gradient that is not finite counts as zero; returns how many there were.
// Moments below the smallest normal float become zero (subnormals are slow and carry nothing).
// The result does not depend on the thread count.
size_t adam_step(std::span<float> parameters, std::span<const float> gradient, AdamState& state,
                 float lr, const AdamSettings& settings = {});

// Euclidean norm over the finite entries, and the number of others.
struct GradientCheck {
  double norm = 0;
  size_t not_finite = 0;
};
GradientCheck check_gradient(std::span<const float> gradient);
// Scales the gradient when its norm is over `limit` (entries that are not finite become zero).
GradientCheck clip_gradient(std::span<float> gradient, double limit);

// Arrays "<name>.m", "<name>.v" and "<name>.step" of a checkpoint.
void save_adam(const AdamState& state, const std::string& name, TensorFile& file);
// Throws Error naming the file unless the arrays are there with `count` entries, finite, v >= 0 and
// step >= 0.
AdamState load_adam(const TensorFile& file, const std::string& name, size_t count);

}  // namespace effigy
