// Two ways to use the machine's vector units:
// - the hot kernels (splat/, shade/) are written with Highway and dispatched at run time;
// - EFFIGY_CLONES marks a function whose plain loops the compiler vectorises, compiled once per
//   instruction-set level and chosen at load time.
#pragma once

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(EFFIGY_SANITIZED)
#define EFFIGY_CLONES __attribute__((target_clones("default", "arch=x86-64-v3", "arch=x86-64-v4")))
#else
#define EFFIGY_CLONES
#endif
