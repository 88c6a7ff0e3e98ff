// The networks of a body avatar: their sizes, and how many parameters they have.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "effigy/base/json.h"

namespace effigy {

// Side of the pictures that the decoders start from.
inline constexpr int kSeedSide = 8;
// Channels that the view-dependent decoder gets of the viewing directions.
inline constexpr int kViewChannels = 8;
// Resolutions of the shadow network.
inline constexpr int kShadowLevels = 4;

struct BodyNetworkSettings {
  std::string size = "small";
  int body_keypoints = 0, face_keypoints = 0;
  std::vector<int> body_hidden, face_hidden;  // widths of the encoders' hidden layers
  int body_latent = 0, face_latent = 0;
  int seed_channels = 0;
  // Channels after each doubling but the last, for both decoders; the last has 65 and 1.
  std::vector<int> decoder;
  int shadow_side = 0, shadow_width = 0;
  // One bias per channel instead of one per channel and texel in the decoders' last layers.
  bool tied_last = false;
  int transfer = 51;  // coefficients of light transfer that the view-independent decoder makes

  // Channels of that decoder (gaussian_channels.h).
  int channels() const { return 14 + transfer; }

  // Texels along each side of the UV picture: 8 times 2 to the number of doublings.
  int texture() const { return kSeedSide << (decoder.size() + 1); }
  // "tiny" (64 texels a side), "small" (256), "full" (1024). Throws Error for another name.
  static BodyNetworkSettings from_size(const std::string& size, int body_keypoints,
                                       int face_keypoints);
  // Throws Error (prefixed by `name`) when a number is out of the range that makes sense.
  void check(const std::string& name) const;
};

Json to_json(const BodyNetworkSettings& settings);
// Throws Error naming `path` and field; the result is checked.
BodyNetworkSettings body_network_settings(const Json& json, const Path& path);

}  // namespace effigy
