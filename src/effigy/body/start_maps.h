// Where a body's albedo starts: from the colours of its texels in the training frames.
#pragma once

#include "effigy/body/model.h"
#include "effigy/body/moments.h"

namespace effigy {

// Least squares over fully lit training frames (others where there are none) and training cameras
// of image = albedo * what the untrained model shows of an albedo of 1, at texels that the camera
// sees. Texels that none sees get the median. The model must be untrained.
void start_albedo(StageMoments& moments, BodyModel& model);

}  // namespace effigy
