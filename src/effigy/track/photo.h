// What the face looks like, for the fit: a small picture of local contrast around the face in every
// frame, and points of the rig's skin that keep their look. Landmarks alone leave a nod and a lid
// uncertain by what amounts to a pixel or two. Private to track/.
#pragma once

#include <vector>

#include "effigy/image/image.h"
#include "effigy/track/face.h"
#include "effigy/track/fit_model.h"

namespace effigy {

// A rectangle of a 3-channel picture (pixels, may leave it) as brightness in [0, 1], of the encoded
// values.
Image grey_part(const Image8& picture, double x, double y, double width, double height,
                int out_width, int out_height);

// Brightness less its local mean, which light changes little, around the face.
struct PhotoWindow {
  Image8 contrast;                      // square, 1 channel; 128 is the local mean; empty: no face
  double left = 0, top = 0, scale = 1;  // pixels of the frame; window pixels a pixel of the frame

  // Contrast (about [-0.3, 0.3]) at a pixel position of the frame and its derivative a pixel; false
  // outside the window.
  bool sample(const Vec2d& pixel, double* value, Vec2d* derivative) const;
};
PhotoWindow photo_window(const Image8& picture, const FaceObservation& face);

// Points of the skin around the landmarks (face, ears, front of the scalp: the face alone hardly
// tells a nod from an expression): triangle and barycentrics on `rig`, at most `count`, by area.
// The same for the same rig.
LandmarkEmbedding choose_photo_points(const Rig& rig, const std::vector<float>& rest, int count);

}  // namespace effigy
