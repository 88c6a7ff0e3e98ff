// One view of a stage capture as training and evaluation use it: cropped to where the body is.
#pragma once

#include "effigy/base/random.h"
#include "effigy/body/losses.h"
#include "effigy/capture/stage_capture.h"

namespace effigy {

struct BodyView {
  Camera camera;  // of the crop
  BodyTarget target;
  int x = 0, y = 0;  // of the crop's corner in the image
};

// The bounding box of the mask, grown by a margin; or, of `crop` > 0 pixels a side, a random square
// of it. Throws Error naming the file when image or mask cannot be read.
BodyView load_body_view(const StageCapture& capture, int frame, int camera, int crop,
                        Random& random);

}  // namespace effigy
