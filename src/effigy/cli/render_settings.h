// Cameras, tracks and lights as the commands name them.
#pragma once

#include <string>

#include "effigy/avatar/head_avatar.h"

namespace effigy {

// A light by built-in name ("studio", ...) or HDR/EXR file, prefiltered. `exposure`: "auto" matches
// the mean radiance of the avatar's own light, else a factor. `rotation` in radians.
PrefilteredEnvironment load_light(const std::string& name, double rotation,
                                  const std::string& exposure, const Cubemap& reference);

// The environment of that name or file; and --exposure as a number. Throw Error.
Image light_image(const std::string& name);
double exposure_factor(const std::string& text);

// Poses by name or path: a track of the avatar ("train"), a track file, or a capture folder: of the
// avatar's rig (as its encoder corrects the tracking) or any other (retargeted by expression and
// joint names).
Track load_drive(const std::string& what, const HeadAvatar& avatar);

// Camera on a circle around the head's mean position: `angle` radians to the avatar's left of the
// capture's camera, `elevation` radians above it, at the capture's distance.
Camera orbit_camera(const Camera& base, const Vec3d& center, double angle, double elevation);

// Centre of the posed head (mean of the vertices).
Vec3d head_center(const std::vector<float>& vertices);

}  // namespace effigy
