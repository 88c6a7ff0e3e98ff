// Material textures as images: out for painting, edited ones back in.
#pragma once

#include <array>

#include "effigy/base/file.h"
#include "effigy/image/image.h"
#include "effigy/splat/surfel_raster.h"

namespace effigy {

// The four maps as float images, row 0 = top (v = 1): albedo sRGB-encoded (3), roughness (1),
// specular = F0 (1), normal OpenGL-encoded (n + 1) / 2 (3).
struct MaterialImages {
  Image albedo, roughness, specular, normal;
};
MaterialImages to_images(const MaterialTexture& texture);
// Maps may differ in size; all are resampled to the largest. Throws Error (prefixed by `name`) for
// a map that is not square, under 16 or over 8192 pixels.
MaterialTexture to_texture(const MaterialImages& images, const std::string& name);

// textures/{albedo,roughness,specular,normal}.png, 16 bit.
void write_material(const Path& folder, const MaterialTexture& texture);
MaterialTexture read_material(const Path& folder);

// The maps that are in the folder (bodies have albedo and roughness only), and back; an image that
// is not there is empty.
MaterialImages read_maps(const Path& folder);
void write_maps(const Path& folder, const MaterialImages& images);

// Where an edited image goes: u0, v0, u1, v1 in [0, 1] (v up); the whole atlas by default.
using UvRectangle = std::array<double, 4>;

// Blends the PNGs found in `folder` (albedo, roughness, specular, normal; any subset) into
// `texture`, each weighted by its alpha channel where it has one (else 1). Normal maps are blended
// and renormalised. Returns the number of maps applied; throws Error when there is none.
int apply_edits(const Path& folder, const UvRectangle& where, MaterialTexture& texture);
// The same on maps as they are in files; those that are empty are left out.
int apply_edits(const Path& folder, const UvRectangle& where, MaterialImages& images);

}  // namespace effigy
