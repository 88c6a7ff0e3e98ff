// The same source as gaussian_kernels.cpp, one lane wide: an oracle for the vector targets.
#define HWY_COMPILE_ONLY_SCALAR
#include "effigy/splat/gaussian_kernels-inl.h"

namespace effigy {
GaussianKernels scalar_gaussian_kernels() {
  return HWY_NAMESPACE::kernels();
}
}  // namespace effigy
