// Running a test with the kernels of one instruction set after the other.
#pragma once

#include <hwy/targets.h>

#include <cstdint>
#include <string>

#include "effigy/splat/kernel_choice.h"

namespace effigy {

// Uses the kernels of one instruction set; 0: the separately compiled one-lane source.
class UseTarget {
 public:
  explicit UseTarget(int64_t target) {
    choose_splat_kernels(target == 0 ? KernelChoice::kScalar : KernelChoice::kBest);
    hwy::SetSupportedTargetsForTest(target);
  }
  ~UseTarget() {
    choose_splat_kernels(KernelChoice::kBest);
    hwy::SetSupportedTargetsForTest(0);
  }
};

inline std::string target_name(int64_t target) {
  return target == 0 ? "one lane" : hwy::TargetName(target);
}

}  // namespace effigy
