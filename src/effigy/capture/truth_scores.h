// How near an avatar comes to what a synthetic capture knows: surfaces layer by layer, and light
// that it was not trained under. Shared by heads and bodies.
#pragma once

#include <optional>
#include <vector>

#include "effigy/base/json.h"
#include "effigy/image/image.h"

namespace effigy {

// One view's surface, as drawn or as it is: all of one size; where alpha is 0, anything.
struct SurfaceImages {
  Image albedo;     // 3, linear
  Image roughness;  // 1: microfacet alpha = roughness^2
  Image specular;   // 1: F0; empty where it is not known
  Image normal;     // 3, world, of any length, with the normal map
  Image depth;      // 1, along the camera's axis, metres
  Image alpha;      // 1
};
// From layers "albedo", "material", "normal", "depth" and "radiance" (capture/truth.h).
SurfaceImages surface_from_layers(Image albedo, const Image& material, Image normal, Image depth,
                                  const Image& radiance);

// Mean absolute difference of sRGB values of linear albedo at these pixels, after the one scale
// (least squares) that is left free between albedo and light. 0 without pixels.
double albedo_difference(const Image& drawn, const Image& truth, const std::vector<size_t>& pixels);

// Means over the pixels that truth and avatar cover whole (alpha above 0.99).
struct SurfaceScores {
  double albedo_error = 0;               // absolute sRGB difference, after one scale a view
  double roughness_error = 0;            // absolute difference
  std::optional<double> specular_error;  // absolute difference of F0
  double normal_degrees = 0;             // angle between normals
  double depth_error_mm = 0;             // absolute difference
  Json to_json() const;
};

// Collects views; means are over all their pixels.
class SurfaceErrors {
 public:
  // Throws Error when sizes differ.
  void add(const SurfaceImages& drawn, const SurfaceImages& truth);
  bool empty() const { return albedo_.weight == 0; }
  SurfaceScores scores() const;

 private:
  struct Mean {
    double sum = 0, weight = 0;
    void add(double value, double by = 1) {
      sum += by * value;
      weight += by;
    }
    double mean() const { return weight > 0 ? sum / weight : 0.0; }
  };
  Mean albedo_, roughness_, specular_, normal_, depth_;
};

// The least-squares scale of drawn values towards true ones, linear, clipped to [0, 1]; sums of
// many pictures can be added.
struct ScaleFit {
  double cross = 0, square = 0;
  // sRGB-encoded images of one size.
  void add(const Image& drawn, const Image& truth);
  void add(const ScaleFit& other);
  double scale() const { return square > 0 && cross > 0 ? cross / square : 1.0; }
};

// An avatar under a light it was not trained under, against the truth.
struct RelightScores {
  double psnr = 0, ssim = 0;
  double psnr_aligned = 0, ssim_aligned = 0;  // after the one global scale that is left free
                                              // between albedo and light
  double scale = 1;
  double psnr_unlit = 0;  // the same views left in the training light, scale-aligned
  Json to_json() const;
};

}  // namespace effigy
