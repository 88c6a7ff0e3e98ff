#include "effigy/body/evaluate.h"

#include <algorithm>

#include "effigy/body/draw.h"
#include "effigy/body/losses.h"
#include "effigy/image/metrics.h"

namespace effigy {
namespace {

constexpr int kBorder = 4;  // pixels kept around the body

}  // namespace

std::vector<StageViewKey> scored_views(const StageCapture& capture, const std::vector<int>& frames,
                                       const std::vector<int>& cameras, size_t most) {
  std::vector<StageViewKey> views;
  const bool any = std::any_of(frames.begin(), frames.end(), [&](int frame) {
    return !capture.cameras_of(frame, cameras).empty();
  });
  if (!any) return views;
  const StageSchedule all = StageSchedule::in_order(capture, frames, cameras);
  const auto size = static_cast<size_t>(all.size());
  const size_t count = most == 0 ? size : std::min(most, size);
  // Where whole frames are stepped over, cameras take turns.
  const bool turns = size / count >= cameras.size();
  for (size_t k = 0; k < count; ++k) {
    const size_t at = k * size / count + (turns ? k % cameras.size() : 0);
    views.push_back(all.view(std::min(at, size - 1)));
  }
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

BodyViewer::BodyViewer(const BodyTrainSettings& settings, BodyModel& model, StageMoments& moments)
    : settings_(settings), model_(model), moments_(moments) {}

DrawnView BodyViewer::draw_in_light_of(const StageViewKey& key, int frame_of_light, double scale) {
  const StageSource& source = moments_.source();
  view_ = source.view(key, {0, kBorder, 0});
  // Under another light another background would have been seen.
  if (!settings_.backgrounds || frame_of_light != key.frame) put_on_black(view_);
  const StageMoment lit_as =
      frame_of_light == key.frame ? *view_.moment : source.moment(frame_of_light);
  const auto light = moments_.light(lit_as);
  model_.pose(moments_.moment(*view_.moment));
  model_.light(moments_.irradiance(*view_.moment, lit_as));
  model_.look(view_.view.center().cast<float>());
  picture_.draw(view_.view, model_.surface(), *light, draw_options(settings_));
  BodyTarget target;
  target.display = source.capture().display;
  target.background = view_.background;
  Planes encoded;
  const auto gain = static_cast<float>(scale);
  body_display(picture_, {.gain = {gain, gain, gain}}, target, encoded);
  DrawnView out;
  out.view = key;
  out.drawn = to_float(to_8bit(to_image(encoded)));
  out.truth = to_image(view_.image);
  out.mask = Image(encoded.width, encoded.height, 1);
  out.mask.data = view_.mask;
  return out;
}

BodyScore score_of(const DrawnView& view) {
  return {psnr(view.drawn, view.truth), ssim(view.drawn, view.truth), flip(view.truth, view.drawn),
          psnr(view.drawn, view.truth, &view.mask)};
}

}  // namespace effigy
