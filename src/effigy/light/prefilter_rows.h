// Sparse rows of the prefilter (environment.h): quadrature of a lobe over a cubemap.
//
// The source's flux pyramid: the finest level holds each source texel's radiance times solid angle;
// every coarser node collects flux from the finer nodes around it with the weights by which
// bilinear (seamless) interpolation would read it back. A lobe sampled at coarse nodes and summed
// against their flux is therefore the sum over source texels of the bilinearly interpolated lobe:
// an error of second order in the node's size.
//
// A row is the lobe in the hierarchical basis of this pyramid: its values at the coarsest nodes,
// and at finer nodes the difference between the lobe and what interpolation from the coarser ones
// already gives, where that matters. Nodes that hold no difference interpolate; the effective
// weight of a source texel is always a blend of lobe values, hence never negative.
//
// Nodes are stored level by level, each level face by face in Z-order, so the four children of node
// i of a level are nodes 4i .. 4i+3 of the next: a row is a list of such groups with four weights.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "effigy/light/cubemap_layout.h"

namespace effigy {

struct FluxPyramid {
  struct Parent {
    uint32_t node;
    float weight;
  };
  int size = 0, depth = 0;     // source = 2^depth
  int coarsest = 0;            // level of 4^2 nodes a face (less for tiny sources)
  std::vector<size_t> offset;  // of each level from 0 (levels below coarsest are empty), depth + 2
  std::vector<std::array<float, 4>> direction;  // [node]: unit centre, angular radius (sine)
  std::vector<float> solid_angle;               // [node]
  std::vector<std::array<Parent, 4>> parents;   // [node]: nodes and weights interpolation reads
  std::vector<float> flux_of_one;               // [node]: flux under radiance 1
  std::vector<uint32_t> source_texel;           // [Z-order index]: texel of the source cubemap

  // n: a power of two.
  explicit FluxPyramid(int n);
  size_t nodes() const { return offset.back(); }
};

// An unnormalised lobe over c = cosine to its axis: GGX with N = V = R. There n.h is the cosine of
// half the angle, so D (R.l) is proportional to c / (1 - (1 - alpha^2)(1 + c) / 2)^2. alpha = 1
// gives the cosine lobe.
struct Lobe {
  float squeeze;    // (1 - alpha^2) / 2
  float core;       // (2 alpha)^2: squared chord at which the lobe has fallen to a quarter
  float peak;       // value at c = 1
  float horizon;    // slope at c = 0
  double integral;  // over the sphere
  explicit Lobe(double alpha);
  float operator()(float c) const {
    const float q = 1.0f - squeeze * (1.0f + c);
    return c > 0.0f ? c / (q * q) : 0.0f;
  }
};

struct PrefilterRows {
  std::vector<uint32_t> group;  // first node of each group
  std::vector<float> weight;    // 4 per group
};

class RowBuilder {
 public:
  RowBuilder(const FluxPyramid& pyramid, double alpha);
  // Appends the row of the lobe around unit `axis`: its sum against radiance 1 is 1.
  void append(const Vec3f& axis, PrefilterRows& rows);

 private:
  bool refine(uint32_t node, float cosine) const;
  void add_group(uint32_t first, int level, const Vec3f& axis, PrefilterRows& rows);
  float lobe_at(uint32_t node, int level, const Vec3f& axis) const;
  float texel_mean(uint32_t z_index, const Vec3f& axis, int grid) const;
  float approximation(uint32_t node, int level);

  const FluxPyramid& pyramid_;
  Lobe lobe_;
  std::vector<float> value_;  // the row's effective lobe at nodes, where stamp_ is current
  std::vector<uint32_t> stamp_;
  uint32_t row_ = 0;
  std::vector<uint32_t> active_, next_;  // nodes whose children are looked at
};

}  // namespace effigy
