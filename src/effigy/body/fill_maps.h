// Albedo and roughness of texels that hardly show, from their neighbours.
#pragma once

#include <span>
#include <vector>

#include "effigy/body/model.h"
#include "effigy/body/moments.h"

namespace effigy {

// Training leaves many Gaussians so small or transparent that they do not show (others cover for
// them), and an albedo that no picture holds decays to black: nothing to paint on. Texels whose
// presence, opacity times area summed over some training frames, is under a tenth of the 90th
// percentile become as the nearest texel in the atlas that shows. For the end of training; pictures
// hardly change.
void fill_hidden_maps(StageMoments& moments, BodyModel& model);

// For each texel the one whose maps it gets: itself where it shows. presence: 1 a texel, not
// negative, on any scale.
std::vector<size_t> standing_in(const UvTexels& texels, std::span<const float> presence);

}  // namespace effigy
