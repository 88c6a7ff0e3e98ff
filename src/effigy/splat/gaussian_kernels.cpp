#include "effigy/splat/gaussian_kernels.h"

// Vectors of unknown size cannot be members of structs.
#undef HWY_DISABLED_TARGETS
#ifdef EFFIGY_SANITIZED
// Checks make these kernels large: the widest common target and the smallest are enough for them.
#define HWY_DISABLED_TARGETS (HWY_SSSE3 | HWY_SSE4 | HWY_AVX3 | HWY_AVX3_DL)
#else
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
#endif
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "effigy/splat/gaussian_kernels.cpp"
#include "hwy/foreach_target.h"
//
#include "effigy/splat/gaussian_kernels-inl.h"

HWY_BEFORE_NAMESPACE();
namespace effigy {
namespace HWY_NAMESPACE {
GaussianKernels gaussian_kernels() {
  return kernels();
}
}  // namespace HWY_NAMESPACE
}  // namespace effigy
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace effigy {
HWY_EXPORT(gaussian_kernels);
GaussianKernels best_gaussian_kernels() {
  return HWY_DYNAMIC_DISPATCH(gaussian_kernels)();
}
std::vector<int64_t> gaussian_kernel_targets() {
  return hwy::SupportedAndGeneratedTargets();
}
}  // namespace effigy
#endif
