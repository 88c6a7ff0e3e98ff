// Which kernels the rasterizers use: the best this machine has, or the same source one lane wide.
#pragma once

namespace effigy {

// kScalar is for tests and benchmarks.
enum class KernelChoice { kBest, kScalar };
void choose_splat_kernels(KernelChoice choice);
KernelChoice splat_kernel_choice();

}  // namespace effigy
