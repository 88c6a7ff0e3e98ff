// Small published networks, run on libtorch's operators. No torch type leaves this room.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

namespace effigy {

// A plain array, row-major; images are [1, height, width, channels].
struct Array {
  std::vector<int64_t> shape;
  std::vector<float> data;

  Array() = default;
  explicit Array(std::vector<int64_t> sides);  // zeros
  int64_t count() const;
};

// A feed-forward network of fixed input sizes. Runs on the calling thread only, without autograd.
// Not to be run from two threads at once: give each thread its own Network.
class Network {
 public:
  // Parses, checks the shape of every intermediate result in one dry run, and keeps the weights
  // (half-precision constants widened once). Throws Error prefixed by `name`.
  static Network from_tflite(std::span<const uint8_t> bytes, const std::string& name);

  Network(Network&&) noexcept;
  Network& operator=(Network&&) noexcept;
  ~Network();

  // One Array per input, of exactly input_shapes(); returns one per output.
  std::vector<Array> run(const std::vector<Array>& inputs);

  const std::vector<std::vector<int64_t>>& input_shapes() const;
  const std::vector<std::vector<int64_t>>& output_shapes() const;
  const std::string& name() const;

 private:
  struct State;
  explicit Network(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace effigy
