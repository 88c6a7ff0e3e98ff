// Scores of body avatars on views of a capture, on the crop around the body.
#pragma once

#include <functional>
#include <vector>

#include "effigy/body/model.h"
#include "effigy/body/moments.h"
#include "effigy/body/stage_views.h"
#include "effigy/body/train_settings.h"
#include "effigy/image/image.h"

namespace effigy {

// Frames as these cameras saw them; at most `most` (0: all), spread over both.
std::vector<StageViewKey> scored_views(const StageCapture& capture, const std::vector<int>& frames,
                                       const std::vector<int>& cameras, size_t most);

struct BodyScore {
  double psnr = 0, ssim = 0, flip = 0;
  double psnr_inside = 0;  // over the mask's pixels alone
};
BodyScore mean_score(const std::vector<BodyScore>& scores);

// One view, drawn and true: display-encoded, 8-bit values, cropped to the body.
struct DrawnView {
  StageViewKey view;
  Image drawn, truth, mask;
};
// Poses the model by the capture's tracking and draws; no camera's own colour is used.
class BodyViewer {
 public:
  // Keeps references.
  BodyViewer(const BodyTrainSettings& settings, BodyModel& model, StageMoments& moments);
  DrawnView draw(const StageViewKey& view) { return draw_in_light_of(view, view.frame); }
  // The same view left in the light of `frame_of_light` (its shadows too); its light times `scale`.
  DrawnView draw_in_light_of(const StageViewKey& view, int frame_of_light, double scale = 1);
  // Of the last draw.
  const BodyPicture& picture() const { return picture_; }
  const StageView& view() const { return view_; }
  const BodySurface& surface() const { return model_.surface(); }
  const BodyTrainSettings& settings() const { return settings_; }

 private:
  const BodyTrainSettings& settings_;
  BodyModel& model_;
  StageMoments& moments_;
  BodyPicture picture_;
  StageView view_;
};

BodyScore score_of(const DrawnView& view);

}  // namespace effigy
