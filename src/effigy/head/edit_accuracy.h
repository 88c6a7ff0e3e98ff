// How well an edit stays where it was painted: a checker is painted over the albedo atlas, and its
// corners in rendered frames are compared with where the rig's surface has these UVs.
#pragma once

#include <vector>

#include "effigy/avatar/head_avatar.h"
#include "effigy/base/json.h"

namespace effigy {

struct EditAccuracy {
  int corners = 0;                 // corners measured over all frames
  double corner_error_median = 0;  // pixels
  double corner_error_p95 = 0;
  double edge_width_median = 0;  // 10-90 % rise across the squares' edges, pixels
  Json to_json() const;
};

// A frame to measure: where the head is and who looks at it.
struct EditView {
  RigPose pose;
  Camera camera;
};

// Squares of 1/cells of the atlas. Corners count where the surface faces the camera (within 50
// degrees), nothing lies in front, and the square is larger than about 12 pixels.
EditAccuracy measure_edit_accuracy(const HeadAvatar& avatar, const std::vector<EditView>& views,
                                   int cells = 24);

// The avatar's albedo replaced by a checker of two colours.
MaterialTexture paint_checker(MaterialTexture texture, int cells);

}  // namespace effigy
