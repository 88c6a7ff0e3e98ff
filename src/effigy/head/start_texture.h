// The materials and the light that training starts from: the frames' own colours under an even,
// white light. What no frame tells of (the top of the head, the light from behind) then stays at
// something sensible.
#pragma once

#include "effigy/head/model.h"

namespace effigy {

// Colours of `frames` (indices into capture.frames) gathered on the textures of `model`, which has
// surfels and shape already; texels that no frame shows are filled from those around them. Sets
// model.material and model.environment.
void start_from_frames(const Capture& capture, const TrainSettings& settings,
                       const std::vector<int>& frames, HeadModel& model);

}  // namespace effigy
