// Draws a head avatar: pose, light, camera in; G-buffer and display-encoded image out.
#pragma once

#include "effigy/avatar/head_avatar.h"
#include "effigy/light/packed_environment.h"
#include "effigy/shade/deferred.h"

namespace effigy {

class HeadRenderer {
 public:
  // Keeps a reference to `avatar`; starts in its training light and rest pose.
  explicit HeadRenderer(const HeadAvatar& avatar);

  void set_light(const PrefilteredEnvironment& light) { light_ = pack_environment(light); }
  void set_pose(const RigPose& pose);
  // Exact: every intersection looks up the texture. Playback: one lookup where the UVs agree, in
  // the material as it is now (call again after changing it).
  void set_exact(bool exact);

  // 3 planes, display-encoded, over `background` (display-encoded).
  const Planes& draw(const Camera& camera, const std::array<float, 3>& background = {0, 0, 0});
  // The G-buffer of the last draw; in playback only the planes that shading reads.
  const Planes& gbuffer() const { return gbuffer_; }
  const std::vector<float>& vertices() const { return vertices_; }
  const PosedSurfels& posed() const { return posed_; }
  int64_t pairs() const { return frame_.pairs(); }

 private:
  const HeadAvatar& avatar_;
  PackedEnvironment light_;
  bool exact_ = true;
  PlaybackTexture playback_material_;
  std::vector<float> vertices_;
  PosedSurfels posed_;
  SurfelFrame frame_;
  Planes gbuffer_, colour_;
};

// A G-buffer plane (or several) as a viewable 8-bit image. Names: albedo roughness specular normal
// mapped_normal depth alpha uv. Throws Error for an unknown name.
Image8 view_buffer(const Planes& gbuffer, const std::string& name);
const std::vector<std::string>& buffer_names();
// The same buffer as linear floats (divided by alpha), for EXR.
Image buffer_values(const Planes& gbuffer, const std::string& name);

// Scale that gives `light` the mean radiance of `reference` (auto exposure of an HDRI).
double exposure_to_match(const Cubemap& light, const Cubemap& reference);

}  // namespace effigy
