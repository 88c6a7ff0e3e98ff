#include "effigy/infer/network.h"

#include <ATen/core/Tensor.h>
#include <c10/core/InferenceMode.h>
#include <c10/util/Exception.h>

#include <algorithm>
#include <cstring>

#include "effigy/base/error.h"
#include "effigy/infer/convolution.h"
#include "effigy/infer/network_steps.h"
#include "effigy/infer/tflite.h"

namespace effigy {

Array::Array(std::vector<int64_t> sides) : shape(std::move(sides)) {
  data.assign(static_cast<size_t>(count()), 0.0f);
}

int64_t Array::count() const {
  int64_t count = 1;
  for (const int64_t side : shape) count *= side;
  return count;
}

struct Network::State {
  std::string name;
  TfliteModel model;  // constants are emptied once the steps hold them
  std::vector<NetworkStep> steps;
  std::vector<std::vector<int>> released;  // tensors no longer needed after each step
  std::vector<std::vector<int64_t>> input_shapes, output_shapes;
  std::vector<at::Tensor> values;

  void plan_releases() {
    std::vector<int> last(model.tensors.size(), -1);
    for (size_t s = 0; s < steps.size(); ++s)
      for (const int input : steps[s].inputs) last[input] = static_cast<int>(s);
    for (const int output : model.outputs) last[output] = -1;
    released.resize(steps.size());
    for (size_t t = 0; t < last.size(); ++t)
      if (last[t] >= 0) released[last[t]].push_back(static_cast<int>(t));
  }

  void execute(bool check) {
    for (size_t s = 0; s < steps.size(); ++s) {
      const NetworkStep& step = steps[s];
      at::Tensor result = step.run(values);
      if (check && result.sizes().vec() != model.tensors[step.output].shape)
        throw Error(name + ": not a sound TFLite network (the result '" +
                    model.tensors[step.output].name +
                    "' has another shape than stated); replace it by the published file.");
      values[step.output] = std::move(result);
      for (const int tensor : released[s]) values[tensor] = at::Tensor();
    }
  }
};

Network::Network(std::unique_ptr<State> state) : state_(std::move(state)) {}
Network::Network(Network&&) noexcept = default;
Network& Network::operator=(Network&&) noexcept = default;
Network::~Network() = default;

Network Network::from_tflite(std::span<const uint8_t> bytes, const std::string& name) {
  auto state = std::make_unique<State>();
  state->name = name;
  state->model = parse_tflite(bytes, name);
  std::vector<Array> zeros;
  try {
    const c10::InferenceMode guard;
    use_torch_threads(1);  // the networks are too small to gain from more
    state->steps = make_steps(state->model, name);
  } catch (const c10::Error& problem) {
    throw Error(name + ": not a sound TFLite network (" + problem.what_without_backtrace() +
                "); replace it by the published file.");
  }
  state->plan_releases();
  state->values.resize(state->model.tensors.size());
  for (const int input : state->model.inputs) {
    state->input_shapes.push_back(state->model.tensors[input].shape);
    zeros.emplace_back(state->model.tensors[input].shape);
  }
  for (const int output : state->model.outputs)
    state->output_shapes.push_back(state->model.tensors[output].shape);
  for (TfliteTensor& tensor : state->model.tensors) {
    std::vector<float>().swap(tensor.floats);
    std::vector<int32_t>().swap(tensor.ints);
  }
  Network network(std::move(state));
  // The dry run checks every shape, so that later runs need not.
  try {
    const c10::InferenceMode guard;
    State& made = *network.state_;
    for (size_t i = 0; i < zeros.size(); ++i)
      made.values[made.model.inputs[i]] = tensor_from(zeros[i].data.data(), zeros[i].shape);
    made.execute(true);
  } catch (const c10::Error& problem) {
    throw Error(name + ": not a sound TFLite network (" + problem.what_without_backtrace() +
                "); replace it by the published file.");
  }
  return network;
}

std::vector<Array> Network::run(const std::vector<Array>& inputs) {
  State& state = *state_;
  EFFIGY_CHECK_EQ(inputs.size(), state.input_shapes.size());
  const c10::InferenceMode guard;
  use_torch_threads(1);
  for (size_t i = 0; i < inputs.size(); ++i) {
    EFFIGY_CHECK(inputs[i].shape == state.input_shapes[i]);
    EFFIGY_CHECK_EQ(inputs[i].data.size(), static_cast<size_t>(inputs[i].count()));
    state.values[state.model.inputs[i]] = tensor_from(inputs[i].data.data(), inputs[i].shape);
  }
  try {
    state.execute(false);
  } catch (const c10::Error& problem) {
    throw Error(state.name + ": the network failed (" + problem.what_without_backtrace() + ").",
                Blame::kInternal);
  }
  std::vector<Array> outputs;
  for (size_t i = 0; i < state.output_shapes.size(); ++i) {
    const at::Tensor result = state.values[state.model.outputs[i]].contiguous();
    Array array(state.output_shapes[i]);
    std::memcpy(array.data.data(), result.data_ptr<float>(), array.data.size() * sizeof(float));
    outputs.push_back(std::move(array));
  }
  return outputs;
}

const std::vector<std::vector<int64_t>>& Network::input_shapes() const {
  return state_->input_shapes;
}
const std::vector<std::vector<int64_t>>& Network::output_shapes() const {
  return state_->output_shapes;
}
const std::string& Network::name() const {
  return state_->name;
}

}  // namespace effigy
