#include "effigy/cli/body_evaluation.h"

#include <algorithm>
#include <chrono>

#include "effigy/base/error.h"
#include "effigy/base/log.h"
#include "effigy/base/progress.h"
#include "effigy/image/metrics.h"

namespace effigy {
namespace {

constexpr size_t kColourViews = 16;

void check_fits(const BodyAvatar& avatar, const StageCapture& capture) {
  const BodyNetworkSettings& networks = avatar.model.networks().settings();
  if (avatar.rig.mesh.triangles != capture.rig.mesh.triangles ||
      networks.body_keypoints != static_cast<int>(capture.body_keypoint_names.size()) ||
      networks.face_keypoints != static_cast<int>(capture.face_keypoint_names.size()))
    throw Error(capture.folder.string() +
                ": its mesh or keypoints are not those the avatar was trained on; give a capture "
                "of the same person.");
}

std::vector<int> partially_lit(const StageCapture& capture, const std::vector<int>& frames) {
  std::vector<int> out;
  for (const int frame : frames)
    if (!capture.frames[static_cast<size_t>(frame)].fully_lit) out.push_back(frame);
  return out;
}

int fully_lit_frame(const StageCapture& capture) {
  for (size_t f = 0; f < capture.frames.size(); ++f)
    if (capture.frames[f].fully_lit) return static_cast<int>(f);
  return -1;
}

// Mean display-encoded colour of the body over fully lit training views; grey without such.
std::array<float, 3> mean_colour(const StageSource& source) {
  const StageCapture& capture = source.capture();
  std::vector<int> frames;
  for (const int frame : capture.frames_of(StageSplit::kTrain))
    if (capture.frames[static_cast<size_t>(frame)].fully_lit) frames.push_back(frame);
  std::array<double, 3> sum{};
  double weight = 0;
  LeftOutViews left_out;
  for (const StageViewKey& key :
       scored_views(capture, frames, capture.train_cameras(), kColourViews)) {
    StageView view;
    try {
      view = source.view(key, {0, 0, 0});
    } catch (const Error& error) {
      left_out.add(error, 10 * kColourViews);  // a sample too small to judge by
      continue;
    }
    for (size_t p = 0; p < view.mask.size(); ++p) {
      weight += static_cast<double>(view.mask[p]);
      for (int c = 0; c < 3; ++c)
        sum[static_cast<size_t>(c)] +=
            static_cast<double>(view.mask[p]) * static_cast<double>(view.image.plane(c)[p]);
    }
  }
  std::array<float, 3> mean{0.5f, 0.5f, 0.5f};
  if (weight > 0)
    for (size_t c = 0; c < 3; ++c) mean[c] = static_cast<float>(sum[c] / weight);
  return mean;
}

DrawnView painted(DrawnView view, const std::array<float, 3>& colour) {
  for (size_t p = 0; p < view.mask.data.size(); ++p)
    for (size_t c = 0; c < 3; ++c) view.drawn.data[3 * p + c] = view.mask.data[p] * colour[c];
  return view;
}

Json score_json(const BodyScore& s) {
  return {{"psnr", s.psnr}, {"ssim", s.ssim}, {"flip", s.flip}, {"psnr_inside", s.psnr_inside}};
}

}  // namespace

BodyScore ViewGroup::mean(BodyScore ViewScores::*which) const {
  std::vector<BodyScore> scores;
  for (const ViewScores& view : views) scores.push_back(view.*which);
  return mean_score(scores);
}

std::map<std::string, double> ViewGroup::mean_distances() const {
  std::map<std::string, double> mean;
  for (const ViewScores& view : views)
    for (const auto& [distance, value] : view.distances)
      mean[distance] += value / static_cast<double>(views.size());
  return mean;
}

std::optional<SurfaceScores> ViewGroup::mean_surface() const {
  SurfaceScores mean;
  double known = 0;
  for (const ViewScores& view : views)
    if (view.surface) {
      mean.albedo_error += view.surface->albedo_error;
      mean.roughness_error += view.surface->roughness_error;
      mean.normal_degrees += view.surface->normal_degrees;
      mean.depth_error_mm += view.surface->depth_error_mm;
      known += 1;
    }
  if (known == 0) return std::nullopt;
  for (double* sum :
       {&mean.albedo_error, &mean.roughness_error, &mean.normal_degrees, &mean.depth_error_mm})
    *sum /= known;
  return mean;
}

const ViewGroup* BodyEvaluation::group(const std::string& name) const {
  for (const ViewGroup& g : groups)
    if (g.name == name) return &g;
  return nullptr;
}

std::vector<ScoredGroup> scored_groups(const StageCapture& capture, size_t most_views) {
  std::vector<int> cameras = capture.test_cameras();
  if (cameras.empty()) cameras = capture.train_cameras();
  const auto group = [&](const char* name, const char* title, const std::vector<int>& frames) {
    return ScoredGroup{name, title, scored_views(capture, frames, cameras, most_views)};
  };
  return {group("view", "held-out cameras, partially lit training frames",
                partially_lit(capture, capture.frames_of(StageSplit::kTrain))),
          group("light", "held-out cameras and lights", capture.frames_of(StageSplit::kLights)),
          group("motion", "held-out cameras, lights and motion",
                capture.frames_of(StageSplit::kMotion)),
          group("environment", "unseen motion under environments",
                capture.frames_of(StageSplit::kEnvironment))};
}

namespace {

// What one avatar on one capture is scored with.
class BodyScorer {
 public:
  BodyScorer(BodyAvatar& avatar, const StageCapture& capture)
      : capture_(capture),
        source_(capture),
        moments_(source_, avatar.model.shadow_texels(), avatar.settings),
        viewer_(avatar.settings, avatar.model, moments_),
        full_(fully_lit_frame(capture)) {
    check_fits(avatar, capture);
  }

  const StageSource& source() const { return source_; }
  bool left_lit() const { return full_ >= 0; }

  ViewScores score(const StageViewKey& key, const std::array<float, 3>& colour,
                   const std::vector<ImageDistance>& distances) {
    ViewScores scores;
    scores.view = key;
    if (full_ >= 0) {
      const DrawnView unlit = viewer_.draw_in_light_of(key, full_);
      scores.unlit = score_of(unlit);
      scores.unlit_fit.add(unlit.drawn, unlit.truth);
    }
    const DrawnView drawn = viewer_.draw(key);
    scores.score = score_of(drawn);
    scores.fit.add(drawn.drawn, drawn.truth);
    scores.flat = score_of(painted(drawn, colour));
    scores.surface = score_surface(viewer_, capture_);
    for (const ImageDistance& distance : distances)
      scores.distances[distance.name] = distance.between(drawn.truth, drawn.drawn);
    return scores;
  }

  // Of views under one environment that were scored as they are.
  RelightScores relight(const std::vector<const ViewScores*>& views) {
    ScaleFit fit, unlit_fit;
    for (const ViewScores* view : views) {
      fit.add(view->fit);
      unlit_fit.add(view->unlit_fit);
    }
    RelightScores mean;
    mean.scale = fit.scale();
    const double share = 1.0 / static_cast<double>(views.size());
    for (const ViewScores* view : views) {
      throw_if_interrupted();
      const StageViewKey& key = view->view;
      const BodyScore aligned = score_of(viewer_.draw_in_light_of(key, key.frame, mean.scale));
      mean.psnr += share * view->score.psnr;
      mean.ssim += share * view->score.ssim;
      mean.psnr_aligned += share * aligned.psnr;
      mean.ssim_aligned += share * aligned.ssim;
      if (full_ >= 0)
        mean.psnr_unlit +=
            share * score_of(viewer_.draw_in_light_of(key, full_, unlit_fit.scale())).psnr;
    }
    return mean;
  }

 private:
  const StageCapture& capture_;
  StageSource source_;
  StageMoments moments_;
  BodyViewer viewer_;
  int full_;  // a fully lit frame, or -1
};

}  // namespace

BodyEvaluation score_body_views(BodyAvatar& avatar, const StageCapture& capture,
                                const BodyEvaluationOptions& options) {
  const auto begin = std::chrono::steady_clock::now();
  BodyEvaluation evaluation;
  evaluation.lpips_net = options.perceptual.lpips_net;
  evaluation.lpips_note = options.perceptual.lpips_note;
  BodyScorer scorer(avatar, capture);
  evaluation.left_lit = scorer.left_lit();
  if (capture.test_cameras().empty())
    log_warning("the capture holds no cameras out; training cameras are scored");
  const std::array<float, 3> colour = mean_colour(scorer.source());

  const std::vector<ScoredGroup> wanted = scored_groups(capture, options.most_views);
  size_t total = 0, here = 0;
  for (const ScoredGroup& w : wanted)
    for (size_t k = 0; k < w.views.size(); ++k) here += options.shard.takes(total++);
  if (total == 0)
    throw Error(capture.folder.string() +
                ": no partially lit or held-out frame to score; capture some.");
  size_t number = 0;
  int64_t done = 0;
  LeftOutViews left_out;
  Progress progress("scoring", "views", static_cast<int64_t>(here));
  for (const ScoredGroup& w : wanted) {
    ViewGroup group{w.name, w.title, {}};
    for (const StageViewKey& key : w.views) {
      if (!options.shard.takes(number++)) continue;
      try {
        group.views.push_back(scorer.score(key, colour, options.perceptual.distances));
      } catch (const Error& error) {
        left_out.add(error, total);
      }
      progress.update(++done);
    }
    if (!group.views.empty()) evaluation.groups.push_back(std::move(group));
  }
  progress.finish();
  evaluation.left_out = left_out.count();
  evaluation.seconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  return evaluation;
}

void score_body_relighting(BodyAvatar& avatar, const StageCapture& capture,
                           BodyEvaluation& evaluation) {
  const ViewGroup* group = evaluation.group("environment");
  if (group == nullptr) return;
  const auto begin = std::chrono::steady_clock::now();
  std::map<std::string, std::vector<const ViewScores*>> by_light;
  for (const ViewScores& view : group->views) {
    const StageFrame& frame = capture.frames[static_cast<size_t>(view.view.frame)];
    by_light[frame.environment.stem().string()].push_back(&view);
  }
  BodyScorer scorer(avatar, capture);
  for (const auto& [light, views] : by_light) evaluation.relight[light] = scorer.relight(views);
  evaluation.seconds +=
      std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

BodyEvaluation evaluate_body(BodyAvatar& avatar, const StageCapture& capture,
                             const BodyEvaluationOptions& options) {
  BodyEvaluation evaluation = score_body_views(avatar, capture, options);
  score_body_relighting(avatar, capture, evaluation);
  return evaluation;
}

Json BodyEvaluation::metrics() const {
  Json json = {{"kind", "body"},
               {"crop", "bounding box of the mask, 4 pixels around it"},
               {"lpips_net", lpips_net.empty() ? Json() : Json(lpips_net)},
               {"views_left_out", left_out},
               {"seconds", seconds}};
  if (lpips_net.empty()) json["lpips_note"] = lpips_note;
  for (const ViewGroup& group : groups) {
    Json entry = score_json(group.mean());
    entry["title"] = group.title;
    entry["views"] = group.views.size();
    for (const auto& [name, value] : group.mean_distances()) entry[name] = value;
    entry["mean_colour"] = score_json(group.mean(&ViewScores::flat));
    if (left_lit) entry["left_fully_lit"] = score_json(group.mean(&ViewScores::unlit));
    if (const auto surface = group.mean_surface()) entry.update(surface->to_json());
    json[group.name] = entry;
  }
  for (const auto& [light, scores] : relight) {
    json["relight"][light] = scores.to_json();
    if (!left_lit) json["relight"][light].erase("psnr_unlit");
  }
  return json;
}

}  // namespace effigy
