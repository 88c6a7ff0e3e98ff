// The rasterizer's inner loops for one instruction set: included by surfel_kernels.cpp once per
// target and by surfel_kernels_scalar.cpp.

#if defined(EFFIGY_SPLAT_SURFEL_KERNELS_INL_H_) == defined(HWY_TARGET_TOGGLE)  // once per target
#ifdef EFFIGY_SPLAT_SURFEL_KERNELS_INL_H_
#undef EFFIGY_SPLAT_SURFEL_KERNELS_INL_H_
#else
#define EFFIGY_SPLAT_SURFEL_KERNELS_INL_H_
#endif

#include "effigy/splat/surfel_backward-inl.h"
#include "effigy/splat/surfel_forward-inl.h"
#include "effigy/splat/surfel_playback-inl.h"

HWY_BEFORE_NAMESPACE();
namespace effigy {
namespace HWY_NAMESPACE {
namespace {

SurfelKernels kernels() {
  return {&forward, &backward, &playback, &halve, hwy::TargetName(HWY_TARGET)};
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace effigy
HWY_AFTER_NAMESPACE();

#endif  // once per target
