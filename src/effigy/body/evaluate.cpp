#include "effigy/body/evaluate.h"

#include <algorithm>

#include "effigy/body/trainer.h"
#include "effigy/image/metrics.h"

namespace effigy {

std::vector<StageView> stage_views(const std::vector<int>& frames, const std::vector<int>& cameras,
                                   size_t most) {
  std::vector<StageView> views;
  const size_t all = frames.size() * cameras.size();
  if (most == 0 || most >= all) {
    for (const int frame : frames)
      for (const int camera : cameras) views.push_back({frame, camera});
    return views;
  }
  // Frames evenly, cameras in turn.
  for (size_t k = 0; k < most; ++k)
    views.push_back({frames[k * frames.size() / most], cameras[k % cameras.size()]});
  return views;
}

BodyScore mean_score(const std::vector<BodyScore>& scores) {
  BodyScore mean;
  for (const BodyScore& score : scores) {
    const double share = 1.0 / static_cast<double>(scores.size());
    mean.psnr += share * score.psnr;
    mean.ssim += share * score.ssim;
    mean.flip += share * score.flip;
    mean.psnr_inside += share * score.psnr_inside;
  }
  return mean;
}

BodyViewer::BodyViewer(const StageCapture& capture, const BodyTrainSettings& settings,
                       BodyModel& model, StageMoments& moments)
    : capture_(capture), settings_(settings), model_(model), moments_(moments) {}

DrawnView BodyViewer::draw(const StageView& view) {
  return draw_in_light_of(view, view.frame);
}

DrawnView BodyViewer::draw_in_light_of(const StageView& view, int frame_of_light) {
  Random unused(0, 0);
  target_ = load_body_view(capture_, view.frame, view.camera, 0, unused);
  const auto light = moments_.light(frame_of_light);
  model_.pose(moments_.moment(view.frame, frame_of_light));
  model_.look(target_.camera.center().cast<float>());
  picture_.draw(target_.camera, model_.surface(), *light, draw_options(settings_));
  Planes encoded;
  body_display(picture_, {}, target_.target, encoded);
  DrawnView out;
  out.view = view;
  out.drawn = to_float(to_8bit(to_image(encoded)));
  out.truth = to_image(target_.target.image);
  out.mask = Image(encoded.width, encoded.height, 1);
  out.mask.data = target_.target.mask;
  return out;
}

BodyScore score_of(const DrawnView& view) {
  return {psnr(view.drawn, view.truth), ssim(view.drawn, view.truth), flip(view.truth, view.drawn),
          psnr(view.drawn, view.truth, &view.mask)};
}

}  // namespace effigy
