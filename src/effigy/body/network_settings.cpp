#include "effigy/body/network_settings.h"

#include "effigy/base/error.h"

namespace effigy {
namespace {

// Calls visit(name, reference) for every setting: the one list that reading and writing share.
template <typename Settings, typename Visit>
void visit_settings(Settings& s, Visit&& visit) {
  visit("size", s.size);
  visit("body_keypoints", s.body_keypoints);
  visit("face_keypoints", s.face_keypoints);
  visit("body_hidden", s.body_hidden);
  visit("face_hidden", s.face_hidden);
  visit("body_latent", s.body_latent);
  visit("face_latent", s.face_latent);
  visit("seed_channels", s.seed_channels);
  visit("decoder", s.decoder);
  visit("shadow_side", s.shadow_side);
  visit("shadow_width", s.shadow_width);
  visit("tied_last", s.tied_last);
  visit("transfer", s.transfer);
}

}  // namespace

BodyNetworkSettings BodyNetworkSettings::from_size(const std::string& size, int body_keypoints,
                                                   int face_keypoints) {
  BodyNetworkSettings s;
  s.size = size;
  s.body_keypoints = body_keypoints;
  s.face_keypoints = face_keypoints;
  if (size == "tiny") {
    s.body_hidden = s.face_hidden = {64};
    s.body_latent = 16;
    s.face_latent = 8;
    s.seed_channels = 32;
    s.decoder = {32, 32};
    s.shadow_side = 64;
    s.shadow_width = 4;
  } else if (size == "small") {
    s.body_hidden = s.face_hidden = {128};
    s.body_latent = 64;
    s.face_latent = 32;
    s.seed_channels = 128;
    s.decoder = {128, 64, 64, 32};
    s.shadow_side = 128;
    s.shadow_width = 8;
  } else if (size == "full") {
    s.body_hidden = {256, 256};
    s.face_hidden = {256};
    s.body_latent = 256;
    s.face_latent = 128;
    s.seed_channels = 256;
    s.decoder = {256, 128, 128, 64, 32, 16};
    s.shadow_side = 256;
    s.shadow_width = 16;
  } else {
    throw Error("'" + size + "' is no size of body networks; choose tiny, small or full.");
  }
  s.check("The body networks");
  return s;
}

void BodyNetworkSettings::check(const std::string& name) const {
  const auto in_range = [&](const char* field, int64_t value, int64_t low, int64_t high) {
    if (value < low || value > high)
      throw Error(name + ": '" + field + "' is " + std::to_string(value) + ", expected " +
                  std::to_string(low) + " to " + std::to_string(high) + ".");
  };
  const auto widths_in_range = [&](const char* field, const std::vector<int>& widths,
                                   int64_t fewest, int64_t most) {
    in_range(field, static_cast<int64_t>(widths.size()), fewest, most);
    for (int width : widths) in_range(field, width, 1, 4096);
  };
  in_range("body_keypoints", body_keypoints, 1, 100000);
  in_range("face_keypoints", face_keypoints, 1, 100000);
  widths_in_range("body_hidden", body_hidden, 0, 8);
  widths_in_range("face_hidden", face_hidden, 0, 8);
  in_range("body_latent", body_latent, 1, 4096);
  in_range("face_latent", face_latent, 1, 4096);
  in_range("seed_channels", seed_channels, 1, 4096);
  widths_in_range("decoder", decoder, 0, 8);
  in_range("shadow_side", shadow_side, 1 << (kShadowLevels - 1), 4096);
  if (shadow_side % (1 << (kShadowLevels - 1)) != 0)
    throw Error(name + ": 'shadow_side' is " + std::to_string(shadow_side) +
                ", expected a multiple of " + std::to_string(1 << (kShadowLevels - 1)) + ".");
  in_range("shadow_width", shadow_width, 1, 4096);
  in_range("transfer", transfer, 1, 4096);
}

Json to_json(const BodyNetworkSettings& settings) {
  Json json = Json::object();
  visit_settings(settings, [&](const char* name, const auto& value) { json[name] = value; });
  return json;
}

BodyNetworkSettings body_network_settings(const Json& json, const Path& path) {
  BodyNetworkSettings settings;
  visit_settings(settings, [&](const char* name, auto& value) {
    value = json_field<std::decay_t<decltype(value)>>(json, name, path);
  });
  settings.check(path.string());
  return settings;
}

}  // namespace effigy
