// Benchmarks of the body's networks, used by `effigy bench --only networks`.
#pragma once

#include <string>
#include <vector>

#include "bench/result.h"

namespace effigy {

// The decoder of `size` ("small" for the figures of BENCHMARKS.md), every texel valid, one frame:
// keypoints to 65 numbers a texel, and with the backward pass to all parameters.
//   body.decoder.forward_ms, body.decoder.forward_backward_ms: milliseconds; ..._processor_ms: of
//     processor time, all threads, which other programs disturb less;
//   body.decoder.bare_forward_ms, body.decoder.bare_forward_backward_ms: a bare loop of oneDNN's
//     convolutions over the same layers (2x2 to four phases, channels last), nothing between them;
//   body.decoder.forward_share, body.decoder.forward_backward_share: bare time over ours, of runs
//     that took turns;
//   body.visibility.forward_ms, body.shadow.forward_ms: the two other networks.
std::vector<BenchResult> bench_networks(const std::string& size, int repeats);

}  // namespace effigy
