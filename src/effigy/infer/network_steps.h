// Private to infer/: TFLite operators as closures over libtorch tensors. Tensors keep TFLite's NHWC
// order; convolutions see them as channels-last NCHW views, which costs nothing.
#pragma once

#include <ATen/core/Tensor.h>

#include <functional>
#include <string>
#include <vector>

#include "effigy/infer/tflite.h"

namespace effigy {

struct NetworkStep {
  std::vector<int> inputs;  // computed tensors it reads
  int output = -1;
  std::function<at::Tensor(const std::vector<at::Tensor>& values)> run;
};

// One step per operator, activations fused into the operator before them. Moves nothing out of
// `model`, but the steps hold copies of its constants. Throws Error (prefixed by `name`).
std::vector<NetworkStep> make_steps(const TfliteModel& model, const std::string& name);

// A copy of `data`.
at::Tensor tensor_from(const float* data, const std::vector<int64_t>& shape);

}  // namespace effigy
