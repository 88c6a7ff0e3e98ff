#include "effigy/infer/backbone.h"

#include <ATen/ops/cat.h>
#include <ATen/ops/max_pool2d.h>
#include <ATen/ops/relu.h>

#include <utility>

#include "effigy/base/error.h"
#include "effigy/infer/convolution.h"
#include "effigy/infer/deep_compression.h"
#include "effigy/infer/network_steps.h"

namespace effigy {
namespace {

using Step = BackboneStep;
using Kind = BackboneStep::Kind;

Step convolution(const std::string& name, int in, int out, int kernel, int stride, int padding,
                 bool tap) {
  return {Kind::kConvolution, name, in, out, kernel, stride, padding, tap, false};
}
Step fire(const std::string& name, int in, int squeezed, int out, bool tap = false) {
  return {Kind::kFire, name, in, out, squeezed, 1, 0, tap, false};
}
Step pool(int kernel, bool ceil) {
  return {Kind::kPool, "", 0, 0, kernel, 2, 0, false, ceil};
}

// torchvision's numbers: features.0 is the first module, ReLUs and pools count.
std::string features(int index) {
  return "features." + std::to_string(index);
}

Backbone alexnet() {
  return {"torchvision's AlexNet",
          {convolution(features(0), 3, 64, 11, 4, 2, true), pool(3, false),
           convolution(features(3), 64, 192, 5, 1, 2, true), pool(3, false),
           convolution(features(6), 192, 384, 3, 1, 1, true),
           convolution(features(8), 384, 256, 3, 1, 1, true),
           convolution(features(10), 256, 256, 3, 1, 1, true)},
          {}};
}

// Blocks of 3x3 convolutions, a pool between blocks; the last of each block is a tap.
Backbone vgg16() {
  Backbone net{"torchvision's VGG16", {}, {}};
  int in = 3, index = 0;
  constexpr std::pair<int, int> kBlocks[] = {{64, 2}, {128, 2}, {256, 3}, {512, 3}, {512, 3}};
  for (const auto& [out, count] : kBlocks) {
    if (index > 0) {
      net.steps.push_back(pool(2, false));
      ++index;
    }
    for (int i = 0; i < count; ++i, index += 2, in = out)
      net.steps.push_back(convolution(features(index), in, out, 3, 1, 1, i + 1 == count));
  }
  return net;
}

Backbone squeezenet11() {
  return {"torchvision's SqueezeNet 1.1",
          {convolution(features(0), 3, 64, 3, 2, 0, true), pool(3, true),
           fire(features(3), 64, 16, 128), fire(features(4), 128, 16, 128, true), pool(3, true),
           fire(features(6), 128, 32, 256), fire(features(7), 256, 32, 256, true), pool(3, true),
           fire(features(9), 256, 48, 384, true), fire(features(10), 384, 48, 384, true),
           fire(features(11), 384, 64, 512, true), fire(features(12), 512, 64, 512, true)},
          {}};
}

// The pools stand elsewhere than in 1.1; the taps are the same modules by name.
Backbone squeezenet10() {
  return {"SqueezeNet 1.0",
          {convolution("conv1", 3, 96, 7, 2, 0, true), pool(3, true), fire("fire2", 96, 16, 128),
           fire("fire3", 128, 16, 128, true), fire("fire4", 128, 32, 256), pool(3, true),
           fire("fire5", 256, 32, 256, true), fire("fire6", 256, 48, 384, true),
           fire("fire7", 384, 48, 384, true), fire("fire8", 384, 64, 512, true), pool(3, true),
           fire("fire9", 512, 64, 512, true)},
          {}};
}
// Its classifier, which the file holds too.
const std::vector<int64_t> kSqueezenetClassifier = {1000, 512, 1, 1};

// One side of a picture after a step; 0 when nothing is left.
int64_t side_after(const Step& step, int64_t side) {
  if (step.kind == Kind::kFire) return side;
  const int64_t room = side + 2 * step.padding - step.kernel + (step.ceil ? step.stride - 1 : 0);
  return room < 0 ? 0 : room / step.stride + 1;
}

at::Tensor run_convolution(const at::Tensor& x, const Backbone::Weights& w, int64_t stride,
                           int64_t padding) {
  if (stride == 1 && x.requires_grad())
    return at::relu(convolve_frozen(x, w.weight, w.bias, padding));
  return at::relu(convolve(x, w.weight, w.bias, {stride, stride}, {padding, padding}, {1, 1}, 1));
}

}  // namespace

std::vector<BackboneLayer> Backbone::layers() const {
  std::vector<BackboneLayer> all;
  for (const Step& step : steps) {
    if (step.kind == Kind::kConvolution)
      all.push_back({step.name, {step.out, step.in, step.kernel, step.kernel}});
    if (step.kind == Kind::kFire) {
      const int64_t squeezed = step.kernel, half = step.out / 2;
      all.push_back({step.name + ".squeeze", {squeezed, step.in, 1, 1}});
      all.push_back({step.name + ".expand1x1", {half, squeezed, 1, 1}});
      all.push_back({step.name + ".expand3x3", {half, squeezed, 3, 3}});
    }
  }
  return all;
}

std::vector<int> Backbone::tap_channels() const {
  std::vector<int> channels;
  for (const Step& step : steps)
    if (step.tap) channels.push_back(step.out);
  return channels;
}

std::vector<at::Tensor> Backbone::features(const at::Tensor& picture) const {
  const auto fits = [&](int64_t side) {
    for (const Step& step : steps) side = side_after(step, side);
    return side > 0;
  };
  if (!fits(picture.size(2)) || !fits(picture.size(3)))
    throw Error("Pictures of " + std::to_string(picture.size(3)) + " x " +
                std::to_string(picture.size(2)) + " are too small for " + name +
                "; leave this distance out.");
  std::vector<at::Tensor> taps;
  at::Tensor x = picture;
  size_t layer = 0;
  for (const Step& step : steps) {
    if (step.kind == Kind::kPool) {
      x = at::max_pool2d(x, {step.kernel, step.kernel}, {step.stride, step.stride}, {0, 0}, {1, 1},
                         step.ceil);
    } else if (step.kind == Kind::kConvolution) {
      x = run_convolution(x, weights[layer++], step.stride, step.padding);
    } else {
      x = run_convolution(x, weights[layer], 1, 0);
      x = at::cat({run_convolution(x, weights[layer + 1], 1, 0),
                   run_convolution(x, weights[layer + 2], 1, 1)},
                  1);
      layer += 3;
    }
    if (step.tap) taps.push_back(x.contiguous());
  }
  return taps;
}

Backbone read_backbone(const std::string& net, const TorchFile& file) {
  Backbone backbone = net == "alex" ? alexnet() : (net == "vgg" ? vgg16() : squeezenet11());
  EFFIGY_CHECK(net == "alex" || net == "vgg" || net == "squeeze");
  const auto fail = [&](const std::string& why) {
    throw Error(file.path().string() + ": not the weights of " + backbone.name + " (" + why +
                "); take the file that torchvision downloads for it.");
  };
  const auto read = [&](const std::string& name, const std::vector<int64_t>& shape) {
    if (!file.has(name))
      fail("there is no '" + name + "'; its first tensor is '" +
           file.names().front().substr(0, 80) + "'");
    if (file.shape(name) != shape)
      fail("'" + name + "' is " + TorchFile::sides(file.shape(name)) + " instead of " +
           TorchFile::sides(shape));
    return tensor_from(file.read(name).data(), shape);
  };
  for (const BackboneLayer& layer : backbone.layers())
    backbone.weights.push_back(
        {read(layer.name + ".weight", layer.shape), read(layer.name + ".bias", {layer.shape[0]})});
  return backbone;
}

Backbone read_squeezenet10(const Path& path) {
  Backbone backbone = squeezenet10();
  std::vector<std::vector<int64_t>> shapes;
  for (const BackboneLayer& layer : backbone.layers()) shapes.push_back(layer.shape);
  shapes.push_back(kSqueezenetClassifier);
  constexpr uint64_t kMostBytes = uint64_t{16} << 20;
  const std::vector<uint8_t> bytes = read_file(path, kMostBytes);
  std::vector<CompressedLayer> layers = parse_deep_compression(bytes, shapes, path.string());
  for (size_t l = 0; l + 1 < layers.size(); ++l)
    backbone.weights.push_back({tensor_from(layers[l].weights.data(), shapes[l]),
                                tensor_from(layers[l].bias.data(), {shapes[l][0]})});
  return backbone;
}

}  // namespace effigy
