// Private to infer/: image classifiers as far as their last tap, with the weights of the user's
// files.
#pragma once

#include <ATen/core/Tensor.h>

#include <string>
#include <vector>

#include "effigy/base/torch_file.h"

namespace effigy {

// One step of a backbone. A fire (SqueezeNet) squeezes to `kernel` channels by 1x1, then expands to
// half of `out` by 1x1 and half by 3x3; a ReLU follows every convolution.
struct BackboneStep {
  enum class Kind { kConvolution, kFire, kPool } kind;
  std::string name;  // in the file, without ".weight"
  int in = 0, out = 0, kernel = 0, stride = 1, padding = 0;
  bool tap = false;
  bool ceil = false;  // kPool: a last, partial window counts
};

// One convolution of a step: its name in the file and the sides of its weight.
struct BackboneLayer {
  std::string name;
  std::vector<int64_t> shape;  // [out, in, k, k]
};

struct Backbone {
  std::string name;  // for messages: "torchvision's VGG16"
  std::vector<BackboneStep> steps;
  struct Weights {
    at::Tensor weight, bias;
  };
  std::vector<Weights> weights;  // one per layer, in order of layers()

  std::vector<BackboneLayer> layers() const;
  std::vector<int> tap_channels() const;
  // Features after each tap of x [1, 3, H, W]. Throws Error when the picture is too small.
  std::vector<at::Tensor> features(const at::Tensor& x) const;
};

// net: "alex", "vgg" or "squeeze". Throws Error naming file and tensor when the file is another
// network's.
Backbone read_backbone(const std::string& net, const TorchFile& file);
// SqueezeNet 1.0 from Deep Compression's file.
Backbone read_squeezenet10(const Path& path);

}  // namespace effigy
