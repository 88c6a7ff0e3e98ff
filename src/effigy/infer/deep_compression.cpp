#include "effigy/infer/deep_compression.h"

#include <bit>
#include <cmath>
#include <cstring>

#include "effigy/base/error.h"

namespace effigy {
namespace {

static_assert(std::endian::native == std::endian::little);

constexpr size_t kValues = 256;

class Reader {
 public:
  Reader(std::span<const uint8_t> bytes, const std::string& name) : bytes_(bytes), name_(name) {}

  [[noreturn]] void fail(const std::string& why) const {
    throw Error(name_ + ": not SqueezeNet 1.0 by Deep Compression (" + why +
                "); take compressed_SqueezeNet.net (675763 bytes) from "
                "songhan/SqueezeNet-Deep-Compression.");
  }
  std::span<const uint8_t> take(size_t count) {
    if (count > bytes_.size() - at_) fail("truncated");
    at_ += count;
    return bytes_.subspan(at_ - count, count);
  }
  std::vector<float> floats(size_t count) {
    std::vector<float> values(count);
    std::memcpy(values.data(), take(4 * count).data(), 4 * count);
    for (const float value : values)
      if (!std::isfinite(value)) fail("a value that is not finite");
    return values;
  }
  uint32_t integer() {
    uint32_t value;
    std::memcpy(&value, take(4).data(), 4);
    return value;
  }
  bool at_end() const { return at_ == bytes_.size(); }

 private:
  std::span<const uint8_t> bytes_;
  const std::string& name_;
  size_t at_ = 0;
};

}  // namespace

std::vector<CompressedLayer> parse_deep_compression(std::span<const uint8_t> bytes,
                                                    const std::vector<std::vector<int64_t>>& shapes,
                                                    const std::string& name) {
  Reader reader(bytes, name);
  std::vector<size_t> listed(shapes.size());
  for (size_t& count : listed) count = reader.integer();
  std::vector<CompressedLayer> layers;
  for (size_t l = 0; l < shapes.size(); ++l) {
    size_t size = 1;
    for (const int64_t side : shapes[l]) size *= static_cast<size_t>(side);
    const std::string layer = "layer " + std::to_string(l + 1);
    if (listed[l] > size) reader.fail(layer + " lists more weights than it has");
    const std::vector<float> values = reader.floats(kValues);
    if (values[0] != 0) reader.fail(layer + " has no zero among its values");
    CompressedLayer result;
    result.bias = reader.floats(static_cast<size_t>(shapes[l][0]));
    const auto codes = reader.take(listed[l]);
    const auto gaps = reader.take((listed[l] + 1) / 2);
    result.weights.assign(size, 0.0f);
    size_t next = 0;  // after the last listed weight
    for (size_t i = 0; i < listed[l]; ++i) {
      next += i % 2 == 0 ? gaps[i / 2] & 15 : gaps[i / 2] >> 4;
      if (next >= size) reader.fail(layer + " lists weights beyond its end");
      result.weights[next++] = values[codes[i]];
    }
    layers.push_back(std::move(result));
  }
  if (!reader.at_end()) reader.fail("longer than its layers");
  return layers;
}

}  // namespace effigy
