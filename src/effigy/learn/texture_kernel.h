// Internal to texture_losses: the vector kernel over rows of texels, apart from the bookkeeping.
#pragma once

#include <cstddef>
#include <cstdint>

namespace effigy::texture_kernel {

// Rows are walked in runs of this many texels (the last of a row may be shorter).
inline constexpr size_t kRun = 32;
enum RunKind : uint8_t {
  kMixed,
  kInterior,  // full run, all texels inside with all four neighbours inside
  kOutside,   // all texels outside
};

// Per lane of a texel; everything the kernel needs to know about channels.
struct alignas(64) Lanes {
  // t = low + range sigmoid(slope raw); dt/draw = slope (t - low)(range - (t - low)) / range.
  float low[8], range[8], inverse_range[8], slope[8];
  float is_normal[8];               // 1 in lanes 5 and 6
  float tv[8];                      // gradient factors: weight / number of texels (/ 3 for albedo)
  float normal[8];                  // inside
  float prior[8], prior_target[8];  // squared, inside
  float albedo_prior[8];            // L1 against another texture, inside
  float boundary[8], boundary_target[8];  // L1, outside; lanes 5, 6: factor of the normal's L1
  float rate[8];                          // Adam: learning rate / (1 - beta1^t)
};

struct Sums {  // of one row, per lane, unweighted
  float tv[8], normal[8], prior[8], albedo_prior[8], boundary[8];
  uint32_t not_finite;
};

struct Row {
  size_t width;
  const uint8_t* flags;        // UvMask::flags
  const uint8_t* kinds;        // RunKind of each run
  const float* texels;         // old values of this row
  const float* below;          // old values of row y - 1 (any valid row where there is none)
  const float* above;          // old values of row y + 1
  const float* albedo_target;  // row of the prior texture, or null
  const float* raw;
  const float* d_texels;
  float* out;  // new texels, or (gradient) d_raw
  // Of the step only. `old` receives a copy of `out` before it is overwritten, and is `texels`; it
  // is not copied (nor read) for runs that rest.
  float* old;
  float* new_raw;       // raw
  float* new_d_texels;  // d_texels
  float* m;
  float* v;
  uint8_t* resting;  // of each run: not 0 when a step without d_texels would change nothing
  Sums* sums;
};

struct Settings {
  Lanes lanes;
  float normal_limit, boundary_tolerance;
  bool tv, tv_squared, prior;  // prior: any of the three priors
  float beta1, beta2, epsilon, inverse_root;
};

// Fused step of one row; gradient of one row; activation of `count` texels.
void step_row(const Settings& settings, const Row& row);
void gradient_row(const Settings& settings, const Row& row);
void activate(const Settings& settings, const float* raw, float* texels, size_t count);

}  // namespace effigy::texture_kernel
