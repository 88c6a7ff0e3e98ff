// From traced radiance to the images of a capture.
#pragma once

#include <string>

#include "effigy/image/image.h"
#include "effigy/light/environment.h"
#include "effigy/synth/path_tracer.h"

namespace effigy {

// Radiance by the program's own deferred split-sum shading of the true G-buffer, `across` x
// `across` rays a pixel; as trace_image gives it: linear, times alpha, 4 channels.
Image split_sum_image(const TraceScene& scene, const Camera& camera,
                      const PrefilteredEnvironment& light, int across);

// The image of linear premultiplied radiance as a capture shows it, before rounding: alpha times
// sRGB(radiance / alpha), on black, which is how the renderer composites (shade/deferred.h).
Image display_image(const Image& radiance);
// `count` planes from `first` on as an interleaved image.
Image planes_image(const Planes& planes, int first, int count);
// The alpha channel, 1 channel.
Image alpha_image(const Image& radiance);

// A built-in light by name or an environment file brought to mean luminance 1 and at most 1024
// pixels across. Throws Error when it is neither or cannot be used.
Image synth_light(const std::string& name_or_file);
// What the light is called in a capture: the built-in name, or the file's without extension.
std::string synth_light_name(const std::string& name_or_file);

// Adds noise of the given standard deviation where alpha is not 0 (in proportion to alpha).
void add_noise(Image& image, const Image& radiance, double deviation, uint64_t seed,
               uint64_t frame);
// To JPEG of the given quality and back.
Image8 compress(const Image8& image, int quality);

}  // namespace effigy
