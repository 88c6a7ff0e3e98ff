// What no training frame shows has learned nothing, or only from what shines through at edges: dark
// blots in the texture, blobs and holes where a head turns beyond the video. Before an avatar is
// saved this goes back to what is known: the surfels of training's start, on the template as it has
// become, in the materials of the surroundings.
#pragma once

#include "effigy/head/model.h"

namespace effigy {

// Surfels of `start` that lie behind the avatar's own surface in all of `frames` (indices
// into capture.frames) replace the trained ones. Texels of triangles of which no
// frame shows the front are filled from those near them (fill_over_surface); others keep their
// bits. Returns how many surfels were replaced.
size_t restore_unseen(const Capture& capture, const std::vector<int>& frames,
                      const BoundSurfels& start, HeadAvatar& avatar);

}  // namespace effigy
