// The same source as surfel_kernels.cpp, one lane wide: the yardstick of `effigy bench` and an
// oracle for the vector targets.
#define HWY_COMPILE_ONLY_SCALAR
#include "effigy/splat/surfel_kernels-inl.h"

namespace effigy {
SurfelKernels scalar_surfel_kernels() {
  return HWY_NAMESPACE::kernels();
}
}  // namespace effigy
