// What the rows of a body study differ in, seen close up: crops of held-out views around ears,
// hair, skin, a raised arm, limbs' shadows, eyes; normals; unseen motion under lamps and
// environments.
#pragma once

#include <string>
#include <vector>

#include "effigy/body/stage_views.h"
#include "effigy/learn/image_losses.h"

namespace effigy {

struct StudyCrop {
  std::string name;   // "ear"
  std::string other;  // the row that stands beside "full"
  StageViewKey view;
  PixelBox box;          // of the camera's image; empty: all of the body
  bool normals = false;  // instead of the picture
};

// The crops that this capture can show, each of the view among those of unseen motion (or of what
// else was held out) on held-out cameras that shows it largest, most from the front and well lit.
// Found by keypoints that are named as `effigy synth body` does; without them only whole bodies.
std::vector<StudyCrop> study_crops(const StageSource& source);

}  // namespace effigy
