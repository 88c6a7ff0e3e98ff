// Perceptual distances of two pictures: how far apart the features are that a network trained on
// ImageNet finds in them (Zhang et al. 2018, The Unreasonable Effectiveness of Deep Features as a
// Perceptual Metric). No torch type leaves this room.
//
// With f_l the features after tap l, n(f) = f / (|f| + 1e-10) over the channels of one pixel:
//
//   LPIPS                d = sum_l mean_pixels sum_c w_lc (n(f_l(a))_c - n(f_l(b))_c)^2
//   feature_squeezenet10 the same without the learned w (LPIPS' own lpips=False baseline)
//
// The networks and the weights are the user's files (docs/evaluation.md):
//   LPIPS backbones, torchvision's layouts; x = (2 v - 1 - shift) / scale:
//     alex     AlexNet         relu1 .. relu5
//     vgg      VGG16           relu1_2 relu2_2 relu3_3 relu4_3 relu5_3
//     squeeze  SqueezeNet 1.1  relu1 fire3 fire5 fire6 fire7 fire8 fire9
//   LPIPS heads, the lpips package's weights/v0.1: lin<tap>.model.1.weight [1, C, 1, 1]
//   SqueezeNet 1.0 by Deep Compression (Han et al. 2016), 675 763 bytes; taps as squeeze; Caffe's
//     input: blue, green, red, 0 .. 255, minus 104, 117, 123
#pragma once

#include <memory>
#include <string>

#include "effigy/base/file.h"
#include "effigy/image/image.h"

namespace effigy {

class PerceptualDistance {
 public:
  // net: "alex", "vgg" or "squeeze". Throws Error naming file and field when the backbone is not
  // that network's, the heads are not for it, or a file is damaged.
  static PerceptualDistance lpips(const std::string& net, const Path& backbone, const Path& heads);
  static PerceptualDistance squeezenet10(const Path& file);

  PerceptualDistance(PerceptualDistance&&) noexcept;
  ~PerceptualDistance();

  // Two sRGB pictures of one size, 3 channels, values in [0, 1]. Runs on thread_count() threads;
  // not to be called from two threads at once. Throws Error for pictures too small for the network.
  double between(const Image& a, const Image& b) const;
  // LPIPS only: values in [0, 1] given to the network as they are, without the step to [-1, 1]. A
  // slip of much of the literature (GTAvatar's and HRAvatar's published figures among them), for
  // comparison with it.
  double between_unit_range(const Image& a, const Image& b) const;
  // The same distance as a loss: between() of two pictures of 3 planes, whose values may leave
  // [0, 1]; adds `weight` times its derivative by `drawn` to `d_drawn`. Pictures with a side below
  // 32 pixels are continued in black. The same input and thread count give the same bits.
  double loss(const Planes& drawn, const Planes& target, float weight, Planes& d_drawn) const;

 private:
  struct State;
  explicit PerceptualDistance(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace effigy
