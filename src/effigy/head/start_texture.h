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

// Fills an image of `channels` interleaved values a pixel from the pixels that have a weight:
// value = (w value + (1 - w) that of the next coarser level) with w = min(1, weight / enough),
// level by level (pull-push, Gortler et al. 1996). Pixels whose weight is at least `enough` keep
// their value. Where there is no weight at all the image is left as it is.
void fill_by_weight(std::vector<float>& values, const std::vector<float>& weights, int width,
                    int height, int channels, float enough);

}  // namespace effigy
