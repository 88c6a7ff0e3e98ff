// An environment as a light source: radiance by direction, and directions drawn where it is bright.
#pragma once

#include <vector>

#include "effigy/geometry/types.h"
#include "effigy/image/image.h"
#include "effigy/light/environment.h"

namespace effigy {

// What directions are drawn in proportion to.
enum class EnvironmentDraw {
  // The mean of r, g, b over its mean on the sphere: for use beside surface samples, which find the
  // even part of the light by themselves (Karlik et al. 2019, "MIS compensation").
  kAboveMean,
  // Luminance: for use alone. luminance(radiance) / density is the same for every sample.
  kLuminance,
};

class EnvironmentSampler {
 public:
  // `equirectangular`: linear radiance, 3 channels, constant over each pixel (as the prefilter of
  // light/ takes it), finite and non-negative; conventions and `rotation` as light/environment.h.
  explicit EnvironmentSampler(const Image& equirectangular, double rotation = 0.0,
                              EnvironmentDraw draw = EnvironmentDraw::kAboveMean);
  // A cubemap of n^2 texels a face, taken as an equirectangular map of 4 n x 2 n pixels.
  EnvironmentSampler(const Cubemap& radiance, EnvironmentDraw draw);

  struct Sample {
    Vec3f direction;  // unit, towards the light
    Vec3f radiance;
    float density;  // per steradian; 0: no sample (nothing there to draw)
  };
  Sample sample(const Vec2f& u) const;
  // Radiance from a unit direction, and the density with which sample() draws it.
  Vec3f radiance(const Vec3f& direction, float& density) const;
  // Integral of the radiance over the sphere.
  const Vec3d& flux() const { return flux_; }
  EnvironmentDraw draw() const { return draw_; }

 private:
  // Draws one of some cells in proportion to their weights, in constant time on average.
  class Table {
   public:
    void build(const std::vector<double>& weights);  // their sum must not be 0
    // The cell that holds u, and u's place in it in [0, 1].
    int find(float u, float& place) const;

   private:
    std::vector<float> cumulative_;  // cells + 1, from 0 to 1
    std::vector<int> guide_;         // the cell that holds k / cells
  };

  size_t pixel(const Vec3f& direction) const;
  float brightness(size_t i) const;

  int width_, height_;
  EnvironmentDraw draw_;
  float rotation_, floor_ = 0;
  double total_ = 0;
  Vec3d flux_ = Vec3d::Zero();
  std::vector<Vec3f> texels_;
  std::vector<float> row_cosine_;  // height + 1, from the top
  Table rows_;
  std::vector<Table> columns_;  // per row
};

}  // namespace effigy
