// The materials and the light that training starts from: the frames' own colours under an even,
// white light. What no frame tells of (the top of the head, the light from behind) then stays at
// something sensible.
#pragma once

#include <functional>

#include "effigy/head/frames.h"
#include "effigy/head/model.h"

namespace effigy {

// Colours of `frames` (indices into capture.frames) gathered on the textures of `model`, which has
// surfels and shape already; texels that no frame shows are filled from those around them. Sets
// model.material and model.environment.
void start_from_frames(const Capture& capture, const TrainSettings& settings,
                       const std::vector<int>& frames, HeadModel& model);

// What gather_frames shows of each frame it has drawn: the posed vertices, the G-buffer, the frame.
using GatherVisitor = std::function<void(const std::vector<float>& vertices, const Planes& gbuffer,
                                         const TargetFrame& target)>;

// What `frames`, with their rig parameters in `poses` (one a frame of the capture), show of each
// texel of a texture of `size`: [texel][8] sums over all their pixels, 0 to 2 the linear colour
// times the weight, 3 the weight, the others 0. A pixel's weight is its share of the texel times
// cos^2 of the angle under which it is seen; pixels near the matte's edge or seen under more than
// 78 degrees have none.
std::vector<float> gather_frames(const Capture& capture, const std::vector<int>& frames,
                                 const std::vector<RigPose>& poses, const RigShape& shape,
                                 const BoundSurfels& surfels, const BindOptions& bind, int size,
                                 const GatherVisitor& visit = {});

}  // namespace effigy
