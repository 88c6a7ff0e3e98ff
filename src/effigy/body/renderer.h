// Draws a body avatar: pose, light and camera in; picture out. Networks are asked again only for
// what changed.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "effigy/body/body_avatar.h"
#include "effigy/body/draw.h"
#include "effigy/body/ground.h"
#include "effigy/body/irradiance.h"

namespace effigy {

// A buffer divided by alpha: as it is, for EXR, and as a picture to look at.
struct BodyBuffer {
  Image values;
  Image8 picture;
};

class BodyRenderer {
 public:
  // Keeps a reference to `avatar`; starts in the rig's rest pose without light.
  explicit BodyRenderer(BodyAvatar& avatar);

  void set_pose(const RigPose& pose);
  void set_points(PointLights points);
  // Takes seconds for cubemaps of 64 and more texels a side.
  void set_environment(const Cubemap& radiance);
  // Rays a texel for shadows (default: those of training).
  void set_shadow_samples(int samples) { samples_ = samples; }
  // A floor that the body's shadow falls on, at this height (metres, world); the background is seen
  // as if it lay there.
  void set_ground(float height) { ground_ = height; }

  // 3 planes, display-encoded, over `background` (display-encoded).
  const Planes& draw(const Camera& camera, const std::array<float, 3>& background = {0, 0, 0});
  // A buffer as it was drawn last, by `camera`; names as body_buffer_names() has them. Throws Error
  // for an unknown name.
  BodyBuffer buffer(const std::string& name, const Camera& camera) const;
  // Of the last draw.
  const BodyPicture& picture() const { return picture_; }
  const std::vector<float>& vertices() const { return moment_.vertices; }

 private:
  void find_shadow();
  // Of lights that have a shadow of their own.
  int groups() const { return avatar_.settings.shadow ? avatar_.settings.shadow_groups : 1; }

  BodyAvatar& avatar_;
  BodyDrawOptions options_;
  int samples_;
  BodyMoment moment_;
  TexelFrames shadow_frames_;
  PointLights points_;  // when there is no environment
  BodyLight light_;
  std::optional<EnvironmentSampler> environment_;
  std::vector<EnvironmentSampler> parts_;  // of it, where light_ has several
  TexelIrradiance irradiance_;
  std::unique_ptr<RayScene> rays_;
  std::optional<float> ground_;
  bool changed_ = true;       // pose or light, since the last picture
  std::optional<Vec3f> eye_;  // that the model has looked from in this pose
  BodyPicture picture_;
  Planes display_;
};

// The surface's albedo splatted: 3 planes, linear, divided by alpha; 0 where nothing is.
Planes body_albedo(const Camera& camera, const BodySurface& surface,
                   const GaussianRasterOptions& options);

// A channel of a picture as a viewable image, divided by alpha. Names: diffuse specular normal
// roughness visibility shadow depth alpha (not albedo). Throws Error for an unknown name.
Image8 view_body_buffer(const BodyPicture& picture, const std::string& name);
const std::vector<std::string>& body_buffer_names();
// The same buffer as linear floats, for EXR.
Image body_buffer_values(const BodyPicture& picture, const std::string& name);

}  // namespace effigy
