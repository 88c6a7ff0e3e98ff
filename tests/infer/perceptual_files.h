// Writes networks for perceptual distances with random weights, in the layouts of the published
// files.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/torch_writer.h"
#include "effigy/base/random.h"

namespace effigy::test {

// name, out, in, kernel
struct LayerSize {
  std::string name;
  int64_t out, in, kernel;
};

inline std::vector<LayerSize> alex_layers() {
  return {{"features.0", 64, 3, 11},
          {"features.3", 192, 64, 5},
          {"features.6", 384, 192, 3},
          {"features.8", 256, 384, 3},
          {"features.10", 256, 256, 3}};
}
inline std::vector<LayerSize> vgg_layers() {
  return {{"features.0", 64, 3, 3},     {"features.2", 64, 64, 3},    {"features.5", 128, 64, 3},
          {"features.7", 128, 128, 3},  {"features.10", 256, 128, 3}, {"features.12", 256, 256, 3},
          {"features.14", 256, 256, 3}, {"features.17", 512, 256, 3}, {"features.19", 512, 512, 3},
          {"features.21", 512, 512, 3}, {"features.24", 512, 512, 3}, {"features.26", 512, 512, 3},
          {"features.28", 512, 512, 3}};
}
inline void add_fire(std::vector<LayerSize>& layers, const std::string& name, int64_t in,
                     int64_t squeezed, int64_t half) {
  layers.push_back({name + ".squeeze", squeezed, in, 1});
  layers.push_back({name + ".expand1x1", half, squeezed, 1});
  layers.push_back({name + ".expand3x3", half, squeezed, 3});
}
inline std::vector<LayerSize> squeeze_layers() {
  std::vector<LayerSize> layers = {{"features.0", 64, 3, 3}};
  add_fire(layers, "features.3", 64, 16, 64);
  add_fire(layers, "features.4", 128, 16, 64);
  add_fire(layers, "features.6", 128, 32, 128);
  add_fire(layers, "features.7", 256, 32, 128);
  add_fire(layers, "features.9", 256, 48, 192);
  add_fire(layers, "features.10", 384, 48, 192);
  add_fire(layers, "features.11", 384, 64, 256);
  add_fire(layers, "features.12", 512, 64, 256);
  return layers;
}
// With the classifier, as in the file.
inline std::vector<LayerSize> squeeze10_layers() {
  std::vector<LayerSize> layers = {{"conv1", 96, 3, 7}};
  add_fire(layers, "fire2", 96, 16, 64);
  add_fire(layers, "fire3", 128, 16, 64);
  add_fire(layers, "fire4", 128, 32, 128);
  add_fire(layers, "fire5", 256, 32, 128);
  add_fire(layers, "fire6", 256, 48, 192);
  add_fire(layers, "fire7", 384, 48, 192);
  add_fire(layers, "fire8", 384, 64, 256);
  add_fire(layers, "fire9", 512, 64, 256);
  layers.push_back({"conv10", 1000, 512, 1});
  return layers;
}

// Uniform weights that keep the size of activations about the same from layer to layer.
inline TorchState random_backbone(const std::vector<LayerSize>& layers, uint64_t seed) {
  Random random(seed);
  TorchState state;
  for (const LayerSize& layer : layers) {
    const int64_t fan_in = layer.in * layer.kernel * layer.kernel;
    const double bound = std::sqrt(6.0 / static_cast<double>(fan_in));
    TorchEntry weight{
        layer.name + ".weight", {layer.out, layer.in, layer.kernel, layer.kernel}, {}};
    weight.values.resize(static_cast<size_t>(layer.out * fan_in));
    for (float& value : weight.values) value = static_cast<float>(random.uniform(-bound, bound));
    TorchEntry bias{layer.name + ".bias", {layer.out}, {}};
    bias.values.resize(static_cast<size_t>(layer.out));
    for (float& value : bias.values) value = static_cast<float>(random.uniform(-0.1, 0.1));
    state.push_back(std::move(weight));
    state.push_back(std::move(bias));
  }
  return state;
}

inline TorchState random_heads(const std::vector<int64_t>& channels, uint64_t seed) {
  Random random(seed);
  TorchState state;
  for (size_t tap = 0; tap < channels.size(); ++tap) {
    TorchEntry head{"lin" + std::to_string(tap) + ".model.1.weight", {1, channels[tap], 1, 1}, {}};
    for (int64_t c = 0; c < channels[tap]; ++c)
      head.values.push_back(static_cast<float>(random.uniform(0.0, 1.0)));
    state.push_back(std::move(head));
  }
  return state;
}

inline std::vector<int64_t> head_channels(const std::string& net) {
  if (net == "alex") return {64, 192, 384, 256, 256};
  if (net == "vgg") return {64, 128, 256, 512, 512};
  return {64, 128, 256, 384, 384, 512, 512};
}

// Prunes and quantises `state` (weights and biases of squeeze10_layers() in turn) in place to what
// Deep Compression can hold, and returns the file.
inline std::string deep_compressed(TorchState& state, uint64_t seed) {
  Random random(seed);
  std::string counts, body;
  const auto append = [](std::string& out, const auto* values, size_t count) {
    out.append(reinterpret_cast<const char*>(values), count * sizeof(*values));
  };
  for (size_t l = 0; l < state.size(); l += 2) {
    std::vector<float>& weights = state[l].values;
    const auto [least, most] = std::minmax_element(weights.begin(), weights.end());
    std::vector<float> book(256, 0.0f);
    for (int i = 1; i < 256; ++i)
      book[i] = *least + (*most - *least) * static_cast<float>(i - 1) / 254.0f;
    std::vector<uint8_t> codes, gaps;
    int gap = 0;
    for (float& weight : weights) {
      // Long runs of zeros need padding codes of value 0.
      const bool kept = random.uniform(0.0, 1.0) < (&weight - weights.data() < 400 ? 0.02 : 0.3);
      const int code =
          1 + static_cast<int>(std::lround(254 * (weight - book[1]) / (book[255] - book[1])));
      weight = kept ? book[code] : 0.0f;
      if (kept || gap == 15) {
        codes.push_back(static_cast<uint8_t>(kept ? code : 0));
        gaps.push_back(static_cast<uint8_t>(gap));
        gap = 0;
      } else {
        ++gap;
      }
    }
    const auto listed = static_cast<uint32_t>(codes.size());
    append(counts, &listed, 1);
    append(body, book.data(), book.size());
    append(body, state[l + 1].values.data(), state[l + 1].values.size());
    append(body, codes.data(), codes.size());
    if (gaps.size() % 2 != 0) gaps.push_back(0);
    for (size_t i = 0; i < gaps.size(); i += 2)
      body += static_cast<char>(gaps[i] | gaps[i + 1] << 4);
  }
  return counts + body;
}

}  // namespace effigy::test
