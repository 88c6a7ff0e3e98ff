// What the files of head captures and stage captures have in common.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "effigy/base/json.h"
#include "effigy/base/safetensors.h"
#include "effigy/geometry/types.h"
#include "effigy/image/colour.h"
#include "effigy/image/image.h"
#include "effigy/rig/rig.h"

namespace effigy {

inline constexpr int kCaptureVersion = 1;

// The fields of capture.json that captures of every kind have; C: Capture or StageCapture.
template <typename C>
Json description_json(const C& capture, const std::string& kind) {
  return {{"format", "effigy-capture"},
          {"version", kCaptureVersion},
          {"kind", kind},
          {"unit", "metre"},
          {"colour", "srgb"},
          {"display", to_string(capture.display)},
          {"source", capture.source},
          {"licence", capture.licence},
          {"consent", capture.consent},
          {"rig", capture.rig.kind},
          {"frames_per_second", capture.frames_per_second},
          {"extra", capture.extra.is_null() ? Json::object() : capture.extra}};
}
// Throws Error naming `file` for a capture of another version or kind.
void check_description(const Json& json, const std::string& kind, const Path& file);
// Reads them after check_description.
template <typename C>
void read_description(const Json& json, const std::string& kind, const Path& file, C& capture) {
  check_description(json, kind, file);
  capture.folder = file.parent_path();
  const auto text = [&](const char* field) {
    return json_field_or<std::string>(json, field, file, "not stated");
  };
  capture.source = text("source");
  capture.licence = text("licence");
  capture.consent = text("consent");
  capture.display =
      display_transform_from_name(json_field_or<std::string>(json, "display", file, "srgb"));
  capture.frames_per_second =
      json_field_or<double>(json, "frames_per_second", file, capture.frames_per_second);
  capture.extra = json_field_or<Json>(json, "extra", file, Json::object());
}

Json camera_json(const std::string& name, const Camera& camera);
// Throws Error naming `file` for an impossible camera.
Camera camera_from_json(const Json& json, const Path& file);

// The path in a field of a capture's JSON, which must stay inside the capture; empty when it is
// absent and not required.
Path path_inside(const Json& object, const std::string& field, const Path& file, bool required);

// Tensors "expression" [F, E], "joint_rotation" [F, 3 J], "translation" [F, 3].
std::vector<RigPose> poses_from(const TensorFile& file, const Rig& rig, size_t count);
void put_poses(const std::vector<RigPose>& poses, const Rig& rig, TensorFile& file);

// The picture with 1 or 3 channels: grey is repeated, alpha and all but the first left out.
Image8 to_channels(const Image8& image, int channels);
// An image of the camera's size with 1 or 3 channels. Throws Error naming the file.
Image8 read_view(const Path& path, const Camera& camera, int channels);

// Channels of the image layers by name (capture/truth.h says what they hold).
const std::map<std::string, int>& layer_channels();
// A layer's image of the camera's size; labels ("part") are at most `parts`. Throws Error naming
// the file when it is absent, of another size, or not finite.
Image read_layer(const Path& path, const std::string& layer, const Camera& camera, size_t parts);

}  // namespace effigy
