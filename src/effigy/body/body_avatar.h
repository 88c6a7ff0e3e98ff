// Body avatars: a folder a person can open (docs/formats.md).
//   avatar.json  rig.safetensors  networks.safetensors  tracks/<name>.safetensors
//   textures/albedo.png roughness.png (16 bit; a changed PNG is an edit)
#pragma once

#include <map>
#include <string>

#include "effigy/avatar/head_avatar.h"
#include "effigy/body/driver.h"
#include "effigy/body/model.h"
#include "effigy/body/train_settings.h"

namespace effigy {

struct BodyAvatar {
  Rig rig;
  BodyModel model;
  BodyDriver driver;
  BodyTrainSettings settings;  // of its training; how it is drawn is among them
  DisplayTransform display = DisplayTransform::kSrgb;
  Camera camera;                        // from which to look when nothing else is said
  std::map<std::string, Track> tracks;  // "train": all frames of the capture
  Json info;  // avatar.json: provenance, settings, metrics; unknown fields are kept
};

// Checks everything it reads; throws Error naming file and field.
BodyAvatar read_body_avatar(const Path& folder);
// Everything but what `model` and `driver` refer to is small: writes the whole folder.
void write_body_avatar(const BodyAvatar& avatar, const Path& folder);
// Albedo (sRGB-encoded, 3 channels) and roughness (the lobe's width in radians, 1 channel) as
// pictures with their gutters filled, and back. Pictures of another size are resampled.
struct BodyMapImages {
  Image albedo, roughness;
};
BodyMapImages to_images(const UvTexels& texels, const BodyMaps& maps);
void from_images(const BodyMapImages& images, const UvTexels& texels, BodyMaps& maps);

}  // namespace effigy
