// Lights made by code, so that nothing needs to be downloaded: equirectangular linear radiance.
#pragma once

#include <string>
#include <vector>

#include "effigy/image/image.h"

namespace effigy {

// "studio" (soft boxes on dark grey), "overcast" (sky gradient), "sunset" (low warm sun, blue sky),
// "window" (a room with one window and a lamp).
std::vector<std::string> builtin_light_names();
// 256 x 128, mean radiance about 1. Throws Error for an unknown name.
Image builtin_light(const std::string& name);

}  // namespace effigy
