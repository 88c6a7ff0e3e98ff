// The start of a frame encoder (avatar/frame_encoder.h): what it looks at, before it has learned.
#pragma once

#include "effigy/avatar/frame_encoder.h"

namespace effigy {

// An encoder whose codes are the first principal components, at most `codes`, of the inputs of
// `frames` (at least 2), with weights of zero. Expressions, rotations, translations, scores and
// landmarks count the same. A component's spread over the frames is the square root of what it has
// among the inputs, the first one's being 1; its limit is `reach` times that.
FrameEncoder start_encoder(const Capture& capture, const std::vector<int>& frames, int codes,
                           double reach);

}  // namespace effigy
