// Head avatars: a folder a person can open (docs/formats.md).
//   avatar.json  rig.safetensors  splats.safetensors  environment.exr  tracks/<name>.safetensors
//   [encoder.safetensors]
//   textures/albedo.png roughness.png specular.png normal.png (16 bit; a changed PNG is an edit)
#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "effigy/avatar/frame_encoder.h"
#include "effigy/base/file.h"
#include "effigy/base/json.h"
#include "effigy/image/colour.h"
#include "effigy/light/environment.h"
#include "effigy/rig/rig.h"
#include "effigy/splat/bind.h"
#include "effigy/splat/surfel_raster.h"

namespace effigy {

// A named sequence of rig parameters (the tracking of a capture).
struct Track {
  double frames_per_second = 25;
  std::vector<int64_t> numbers;  // original frame numbers
  std::vector<RigPose> poses;
};

struct HeadAvatar {
  Rig rig;         // identity and training's refinements are in its template and bases
  RigShape shape;  // what deforms; joints as trained
  BoundSurfels surfels;
  BindOptions bind;
  MaterialTexture material;
  Cubemap environment;  // linear radiance, the training light
  Camera camera;        // of the capture
  DisplayTransform display = DisplayTransform::kSrgb;
  std::optional<FrameEncoder> encoder;  // corrects the tracking of captures that drive it
  std::map<std::string, Track> tracks;  // "train": all frames of the capture, as refined
  Json info;  // avatar.json: provenance, settings, metrics; unknown fields are kept
};

// Checks everything it reads; throws Error naming file and field.
HeadAvatar read_head_avatar(const Path& folder);
// Writes the whole folder (base/file.h FolderWriter is the caller's).
void write_head_avatar(const HeadAvatar& avatar, const Path& folder);

Track read_track(const Path& path, const Rig& rig);
void write_track(const Path& path, const Track& track, const Rig& rig);

// The expressions and poses of a capture or track of another rig of the same kind, or of any rig
// that shares expression names: coefficients are matched by name, joints by name.
RigPose retarget(const RigPose& pose, const Rig& from, const Rig& to);

}  // namespace effigy
