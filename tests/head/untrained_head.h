// An avatar of the tiny capture as training starts with it.
#pragma once

#include "effigy/head/trainer.h"
#include "support.h"
#include "tiny_capture.h"

namespace effigy::test {

class UntrainedHead : public ::testing::Test {
 protected:
  explicit UntrainedHead(int surfels = 3000) {
    write_tiny_capture(folder_.path());
    capture_ = read_capture(folder_.path());
    TrainSettings settings = TrainSettings::from_preset("quick");
    settings.surfels = surfels;
    settings.texture_size = 64;
    settings.fit_silhouette = false;
    avatar_ = HeadTrainer(capture_, settings).avatar();
  }

  // As training makes them: nothing of the back shines through.
  void make_opaque(float logit) {
    std::fill(avatar_.surfels.opacity_logit.begin(), avatar_.surfels.opacity_logit.end(), logit);
  }

  ScratchFolder folder_;
  Capture capture_;
  HeadAvatar avatar_;
};

}  // namespace effigy::test
