// The network of a body training's perceptual term, from the user's files (in effigy-learn).
#pragma once

#include <string>

#include "effigy/body/losses.h"

namespace effigy {

// `network`: a value of the setting `perceptual` (docs/body-training.md); `models`: folder of the
// files, empty: $EFFIGY_DATA/perceptual. Empty for "none". Throws Error when a file is missing or
// damaged.
PictureDistance training_distance(const std::string& network, const std::string& models);

}  // namespace effigy
