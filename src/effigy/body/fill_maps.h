// Albedo and roughness of texels that hardly show, from their neighbours.
#pragma once

#include <span>

#include "effigy/body/model.h"
#include "effigy/body/moments.h"

namespace effigy {

// Training leaves many Gaussians so small or transparent that they do not show (others cover for
// them), and an albedo that no picture holds decays to black: nothing to paint on. Texels whose
// presence, opacity times area summed over some training frames, is under a tenth of the 90th
// percentile get the mean of their neighbours in the atlas, weighted by presence and distance. For
// the end of training; pictures hardly change.
void fill_hidden_maps(StageMoments& moments, BodyModel& model);

// The same for one map of `channels` numbers a texel. presence: 1 a texel, on any scale.
void fill_hidden_texels(const UvTexels& texels, std::span<const float> presence, size_t channels,
                        std::span<float> map);

}  // namespace effigy
