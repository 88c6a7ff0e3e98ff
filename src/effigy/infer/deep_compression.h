// Networks in the format of Deep Compression (Han et al. 2016), as
// songhan/SqueezeNet-Deep-Compression publishes SqueezeNet 1.0: pruned weights, each one of 256
// shared values.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace effigy {

struct CompressedLayer {
  std::vector<float> weights;  // [out][in][k][k]
  std::vector<float> bias;     // [out]
};

// `shapes`: the sides [out, in, k, k] of each layer's weights, in the file's order. The file: one
// count of listed weights a layer (uint32); then for each layer 256 values (float32), the bias
// (float32), a value number (uint8) for each listed weight, and the gaps before them (4 bits each,
// the low half of a byte first). Weights between are zero. Throws Error, beginning with `name`,
// unless it fits to the last byte.
std::vector<CompressedLayer> parse_deep_compression(std::span<const uint8_t> bytes,
                                                    const std::vector<std::vector<int64_t>>& shapes,
                                                    const std::string& name);

}  // namespace effigy
