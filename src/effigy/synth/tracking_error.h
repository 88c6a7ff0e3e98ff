// What a tracker would have made of a known performance.
#pragma once

#include <vector>

#include "effigy/rig/rig.h"

namespace effigy {

// Poses with errors of a tracker's kind: a third constant, two thirds wandering slowly. `amount` 1:
// standard deviations of about 1 mm of translation, half a degree of every joint that is not an
// eye, 0.03 of every expression (kept within the rig's range). 0: the poses themselves.
std::vector<RigPose> with_tracking_error(const Rig& rig, const std::vector<RigPose>& poses,
                                         double frames_per_second, double amount, uint64_t seed);

}  // namespace effigy
