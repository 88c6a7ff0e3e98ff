// LPIPS and feature_squeezenet10 once more, in plain double-precision loops written from the
// papers' and torchvision's module lists; shares no code with the library.
#pragma once

#include <cmath>
#include <map>
#include <string>
#include <vector>

#include "effigy/image/image.h"

namespace effigy::test {

struct Feature {
  int channels = 0, height = 0, width = 0;
  std::vector<double> data;
  Feature(int c, int h, int w)
      : channels(c), height(h), width(w), data(static_cast<size_t>(c) * h * w, 0.0) {}
  double& at(int c, int y, int x) {
    return data[(static_cast<size_t>(c) * height + y) * width + x];
  }
  double at(int c, int y, int x) const {
    return data[(static_cast<size_t>(c) * height + y) * width + x];
  }
};

// Weights by name, e.g. "features.0.weight" [out][in][k][k] and "features.0.bias".
using WeightsByName = std::map<std::string, std::vector<float>>;

class PerceptualOracle {
 public:
  explicit PerceptualOracle(const WeightsByName& weights) : weights_(weights) {}

  std::vector<Feature> alex(Feature x) {
    taps_.clear();
    x = tap(relu_conv(x, "features.0", 64, 11, 4, 2));
    x = tap(relu_conv(max_pool(x, 3, false), "features.3", 192, 5, 1, 2));
    x = tap(relu_conv(max_pool(x, 3, false), "features.6", 384, 3, 1, 1));
    x = tap(relu_conv(x, "features.8", 256, 3, 1, 1));
    tap(relu_conv(x, "features.10", 256, 3, 1, 1));
    return taps_;
  }
  std::vector<Feature> vgg(Feature x) {
    taps_.clear();
    x = relu_conv(x, "features.0", 64, 3, 1, 1);
    x = tap(relu_conv(x, "features.2", 64, 3, 1, 1));  // relu1_2
    x = relu_conv(max_pool(x, 2, false), "features.5", 128, 3, 1, 1);
    x = tap(relu_conv(x, "features.7", 128, 3, 1, 1));  // relu2_2
    x = relu_conv(max_pool(x, 2, false), "features.10", 256, 3, 1, 1);
    x = relu_conv(x, "features.12", 256, 3, 1, 1);
    x = tap(relu_conv(x, "features.14", 256, 3, 1, 1));  // relu3_3
    x = relu_conv(max_pool(x, 2, false), "features.17", 512, 3, 1, 1);
    x = relu_conv(x, "features.19", 512, 3, 1, 1);
    x = tap(relu_conv(x, "features.21", 512, 3, 1, 1));  // relu4_3
    x = relu_conv(max_pool(x, 2, false), "features.24", 512, 3, 1, 1);
    x = relu_conv(x, "features.26", 512, 3, 1, 1);
    tap(relu_conv(x, "features.28", 512, 3, 1, 1));  // relu5_3
    return taps_;
  }
  std::vector<Feature> squeeze(Feature x) {
    taps_.clear();
    x = tap(relu_conv(x, "features.0", 64, 3, 2, 0));
    x = fire(max_pool(x, 3, true), "features.3", 16, 64);
    x = tap(fire(x, "features.4", 16, 64));
    x = fire(max_pool(x, 3, true), "features.6", 32, 128);
    x = tap(fire(x, "features.7", 32, 128));
    x = tap(fire(max_pool(x, 3, true), "features.9", 48, 192));
    x = tap(fire(x, "features.10", 48, 192));
    x = tap(fire(x, "features.11", 64, 256));
    tap(fire(x, "features.12", 64, 256));
    return taps_;
  }
  std::vector<Feature> squeeze10(Feature x) {
    taps_.clear();
    x = tap(relu_conv(x, "conv1", 96, 7, 2, 0));
    x = fire(max_pool(x, 3, true), "fire2", 16, 64);
    x = tap(fire(x, "fire3", 16, 64));
    x = fire(x, "fire4", 32, 128);
    x = tap(fire(max_pool(x, 3, true), "fire5", 32, 128));
    x = tap(fire(x, "fire6", 48, 192));
    x = tap(fire(x, "fire7", 48, 192));
    x = tap(fire(x, "fire8", 64, 256));
    tap(fire(max_pool(x, 3, true), "fire9", 64, 256));
    return taps_;
  }

  // [-1, 1] (or [0, 1] as it is) through LPIPS' scaling layer.
  static Feature lpips_input(const Image& image, bool unit_range) {
    const double shift[3] = {-.030, -.088, -.188}, scale[3] = {.458, .448, .450};
    Feature x(3, image.height, image.width);
    for (int c = 0; c < 3; ++c)
      for (int y = 0; y < image.height; ++y)
        for (int i = 0; i < image.width; ++i) {
          const double v = static_cast<double>(image.at(i, y)[c]);
          x.at(c, y, i) = ((unit_range ? v : 2 * v - 1) - shift[c]) / scale[c];
        }
    return x;
  }
  static Feature caffe_input(const Image& image) {
    const double mean[3] = {104, 117, 123};
    Feature x(3, image.height, image.width);
    for (int c = 0; c < 3; ++c)
      for (int y = 0; y < image.height; ++y)
        for (int i = 0; i < image.width; ++i)
          x.at(c, y, i) = 255 * static_cast<double>(image.at(i, y)[2 - c]) - mean[c];
    return x;
  }

  // heads: one row of weights a tap; empty: all 1.
  static double distance(const std::vector<Feature>& a, const std::vector<Feature>& b,
                         const std::vector<std::vector<float>>& heads) {
    double sum = 0;
    for (size_t l = 0; l < a.size(); ++l) {
      double of_tap = 0;
      for (int y = 0; y < a[l].height; ++y)
        for (int x = 0; x < a[l].width; ++x) {
          const double na = norm(a[l], y, x), nb = norm(b[l], y, x);
          for (int c = 0; c < a[l].channels; ++c) {
            const double d = a[l].at(c, y, x) / (na + 1e-10) - b[l].at(c, y, x) / (nb + 1e-10);
            of_tap += (heads.empty() ? 1.0 : static_cast<double>(heads[l][c])) * d * d;
          }
        }
      sum += of_tap / (static_cast<double>(a[l].height) * a[l].width);
    }
    return sum;
  }

 private:
  static double norm(const Feature& f, int y, int x) {
    double sum = 0;
    for (int c = 0; c < f.channels; ++c) sum += f.at(c, y, x) * f.at(c, y, x);
    return std::sqrt(sum);
  }
  const Feature& tap(const Feature& x) {
    taps_.push_back(x);
    return taps_.back();
  }

  Feature relu_conv(const Feature& in, const std::string& name, int out, int kernel, int stride,
                    int padding) {
    const std::vector<float>& weight = weights_.at(name + ".weight");
    const std::vector<float>& bias = weights_.at(name + ".bias");
    Feature result(out, (in.height + 2 * padding - kernel) / stride + 1,
                   (in.width + 2 * padding - kernel) / stride + 1);
    const float* w = weight.data();
    for (int o = 0; o < out; ++o) {
      for (int y = 0; y < result.height; ++y)
        for (int x = 0; x < result.width; ++x) result.at(o, y, x) = static_cast<double>(bias[o]);
      for (int c = 0; c < in.channels; ++c)
        for (int v = 0; v < kernel; ++v)
          for (int u = 0; u < kernel; ++u) {
            const double value = static_cast<double>(*w++);
            for (int y = 0; y < result.height; ++y) {
              const int row = y * stride - padding + v;
              if (row < 0 || row >= in.height) continue;
              for (int x = 0; x < result.width; ++x) {
                const int column = x * stride - padding + u;
                if (column >= 0 && column < in.width)
                  result.at(o, y, x) += value * in.at(c, row, column);
              }
            }
          }
    }
    for (double& value : result.data) value = std::fmax(value, 0.0);
    return result;
  }

  // Windows of stride 2; `ceil`: also the last one that begins inside.
  static Feature max_pool(const Feature& in, int kernel, bool ceil) {
    const auto sides = [&](int n) { return (n - kernel + (ceil ? 1 : 0)) / 2 + 1; };
    Feature out(in.channels, sides(in.height), sides(in.width));
    for (int c = 0; c < in.channels; ++c)
      for (int y = 0; y < out.height; ++y)
        for (int x = 0; x < out.width; ++x) {
          double most = -1e300;
          for (int v = 2 * y; v < std::min(2 * y + kernel, in.height); ++v)
            for (int u = 2 * x; u < std::min(2 * x + kernel, in.width); ++u)
              most = std::fmax(most, in.at(c, v, u));
          out.at(c, y, x) = most;
        }
    return out;
  }

  // `half`: channels of each of the two expansions.
  Feature fire(const Feature& in, const std::string& name, int squeezed, int half) {
    const Feature middle = relu_conv(in, name + ".squeeze", squeezed, 1, 1, 0);
    const Feature one = relu_conv(middle, name + ".expand1x1", half, 1, 1, 0);
    const Feature three = relu_conv(middle, name + ".expand3x3", half, 3, 1, 1);
    Feature out(2 * half, in.height, in.width);
    std::copy(one.data.begin(), one.data.end(), out.data.begin());
    std::copy(three.data.begin(), three.data.end(),
              out.data.begin() + static_cast<std::ptrdiff_t>(one.data.size()));
    return out;
  }

  const WeightsByName& weights_;
  std::vector<Feature> taps_;
};

}  // namespace effigy::test
