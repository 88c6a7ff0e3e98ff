// Layers of networks over UV space, on libtorch's autograd: weight norm and untied biases
// everywhere. For learn/ and body/ only: it brings libtorch's headers along.
//
// Weight norm: W = g_o V / |V|, with one norm over the whole V and one gain per output channel,
// which starts at |V| (times `gain`). Untied bias: one number per output channel and pixel, zero
// at first. V starts uniform within +-sqrt(3) s,
//   s = sqrt(2 / (1 + a^2)) sqrt(2 / ((in + out) area)),
// a = the activation's slope, or 1 for none; area = the kernel's, a quarter of it for the stride-2
// transposed convolution, whose four phases start equal (so it starts as box upsampling).
// These are the layers of the public Gaussian codec avatars (Saito et al. 2024).
//
// Pictures are [height, width, channels]; all tensors of one network have one type, float or
// double.
#pragma once

#include <ATen/core/Tensor.h>

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "effigy/base/safetensors.h"

namespace effigy {

inline constexpr double kLeakySlope = 0.2;

struct Parameter {
  std::string name;
  std::vector<int64_t> shape;
  at::Tensor value;  // contiguous leaf that collects a gradient; undefined when only counted
  int64_t count() const;
};

// Where the parameters of a network come from, and the list of them in the order they were made.
class ParameterMaker {
 public:
  // Names and shapes only: nothing is allocated.
  static ParameterMaker counting();
  // Random from `seed`: the same numbers whatever the type.
  static ParameterMaker initial(uint64_t seed, at::ScalarType type);
  // From the file, which throws Error naming file and tensor when one is missing, of another shape
  // or not finite; memory is only taken for what the file holds.
  static ParameterMaker from_file(const TensorFile& file, const std::string& prefix);

  // Uniform in +-bound.
  at::Tensor uniform(const std::string& name, std::vector<int64_t> shape, double bound);
  // Kernels of an UpLayer, [2, 2, in, 2, 2, out], whose four phases are equal, uniform in +-bound.
  at::Tensor equal_phases(const std::string& name, int64_t in, int64_t out, double bound);
  at::Tensor constant(const std::string& name, std::vector<int64_t> shape, double value);

  bool only_counts() const { return mode_ == Mode::kCount; }
  std::vector<Parameter>& parameters() { return parameters_; }

 private:
  enum class Mode { kCount, kInitial, kFile };
  // Files [shape] under `name`; fill(values) gives the initial values.
  at::Tensor make(const std::string& name, std::vector<int64_t> shape,
                  const std::function<void(std::vector<double>&)>& fill);

  Mode mode_ = Mode::kCount;
  uint64_t seed_ = 0;
  at::ScalarType type_ = at::ScalarType::Float;
  const TensorFile* file_ = nullptr;
  std::string prefix_;
  std::vector<Parameter> parameters_;
};

struct LayerOptions {
  double slope = kLeakySlope;  // 1: linear
  bool tied = false;           // one bias per channel
  double gain = 1.0;           // g starts at gain |V|
};

// x [rows, in] -> [rows, out]; one bias per output.
class DenseLayer {
 public:
  DenseLayer(ParameterMaker& make, const std::string& name, int64_t in, int64_t out,
             const LayerOptions& options = {});
  at::Tensor operator()(const at::Tensor& x) const;

 private:
  at::Tensor v_, g_, bias_;
  double slope_;
};

// Convolution 3x3, zeros around: [side, side, in] -> [side, side, out].
class ConvLayer {
 public:
  ConvLayer(ParameterMaker& make, const std::string& name, int64_t in, int64_t out, int64_t side,
            const LayerOptions& options = {});
  at::Tensor operator()(const at::Tensor& x) const;

 private:
  at::Tensor v_, g_, bias_;
  double slope_;
};

// Transposed convolution 4x4, stride 2, padding 1 (up_convolution.h):
// [side, side, in] -> [2 side, 2 side, out].
class UpLayer {
 public:
  UpLayer(ParameterMaker& make, const std::string& name, int64_t in, int64_t out, int64_t side,
          const LayerOptions& options = {});
  at::Tensor operator()(const at::Tensor& x) const;

 private:
  at::Tensor v_, g_, bias_;
  double slope_;
};

// g_o V / |V| along dimension `out` of V, which has g's length.
at::Tensor weight_norm(const at::Tensor& v, const at::Tensor& g, int64_t out);
// up_convolution() with gradients: x [h, w, in], weight [2, 2, in, 2, 2, out], bias
// [2 h, 2 w, out] or [out] -> [2 h, 2 w, out].
at::Tensor up_convolve(const at::Tensor& x, const at::Tensor& weight, const at::Tensor& bias,
                       double slope);
// Convolution of stride 1 over a picture: x [h, w, in], weight [out, in, k, k].
at::Tensor convolve_picture(const at::Tensor& x, const at::Tensor& weight, int64_t padding);
// Bilinear, corners on corners: [h, w, c] -> [side, side, c].
at::Tensor resize_picture(const at::Tensor& x, int64_t side);
// The pixels of a picture [h, w, c] that `pixels` names (ascending row-major indices): [pixels, c].
at::Tensor gather_pixels(const at::Tensor& picture, const at::Tensor& pixels);

}  // namespace effigy
