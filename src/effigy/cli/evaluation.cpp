#include "effigy/cli/evaluation.h"

#include <chrono>
#include <cmath>

#include "effigy/avatar/renderer.h"
#include "effigy/base/log.h"
#include "effigy/cli/render_settings.h"
#include "effigy/image/files.h"

namespace effigy {
namespace {

// Of captures that have albedo images but no layers: mean over frames of the difference inside the
// matte. Empty without such images.
std::optional<double> albedo_error(const HeadAvatar& avatar, const Capture& capture,
                                   const std::vector<int>& frames) {
  HeadRenderer renderer(avatar);
  double sum = 0;
  int count = 0;
  for (int frame : frames) {
    if (capture.frames[frame].albedo.empty()) continue;
    Image truth = to_float(read_image8(capture.folder / capture.frames[frame].albedo));
    for (float& value : truth.data) value = linear_from_srgb(value);
    const Image8 mask = capture.load_mask(frame);
    std::vector<size_t> pixels;
    for (size_t i = 0; i < mask.data.size(); ++i)
      if (mask.data[i] > 250) pixels.push_back(i);
    if (pixels.empty()) continue;
    renderer.set_pose(tracked_pose(avatar, capture, frame));
    renderer.draw(capture.camera);
    sum += albedo_difference(buffer_values(renderer.gbuffer(), "albedo"), truth, pixels);
    ++count;
  }
  if (count == 0) return std::nullopt;
  return sum / count;
}

// The scored poses, each seen from the capture's camera or from one of four others around it.
std::vector<EditView> edit_views(const HeadAvatar& avatar, const Evaluation& evaluation) {
  constexpr double kAngles[5][2] = {{0, 0}, {0.3, 0}, {-0.3, 0}, {0, 0.2}, {0, -0.2}};
  std::vector<EditView> views;
  std::vector<float> vertices;
  for (size_t i = 0; i < evaluation.tracked.poses.size() && i < 100; ++i) {
    const RigPose& pose = evaluation.tracked.poses[i];
    pose_vertices(avatar.shape, pose, vertices);
    const double* angle = kAngles[i % 5];
    const Camera camera =
        i % 5 == 0 ? avatar.camera
                   : orbit_camera(avatar.camera, head_center(vertices), angle[0], angle[1]);
    views.push_back({pose, camera});
  }
  return views;
}

}  // namespace

Evaluation score_frames(const HeadAvatar& avatar, const Capture& capture,
                        const EvaluationOptions& options) {
  check_rigs_agree(avatar, capture);
  const auto begin = std::chrono::steady_clock::now();
  Evaluation evaluation;
  std::vector<int> held_out = capture.test_frames();
  if (held_out.empty()) {
    log_warning("the capture holds no frames out; scoring all of them");
    held_out = capture.train_frames();
  }
  if (held_out.empty())
    throw Error(capture.folder.string() + ": no tracked frame to score; track the video again.");
  if (options.most_frames > 0) held_out = spread_frames(held_out, options.most_frames);
  for (size_t k = 0; k < held_out.size(); ++k)
    if (options.shard.takes(k)) evaluation.frames.push_back(held_out[k]);
  evaluation.lpips_net = options.perceptual.lpips_net;
  evaluation.lpips_note = options.perceptual.lpips_note;
  const std::vector<ImageDistance>& distances = options.perceptual.distances;
  evaluation.tracker = evaluate_tracker(avatar, capture, evaluation.frames, distances);
  evaluation.tracked = avatar.encoder
                           ? evaluate_tracked(avatar, capture, evaluation.frames, distances)
                           : evaluation.tracker;
  if (options.refined)
    evaluation.refined =
        evaluate_refined(avatar, capture, evaluation.frames, options.refine_steps, distances);
  evaluation.seconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  return evaluation;
}

void score_as_a_whole(const HeadAvatar& avatar, const Capture& capture, Evaluation& evaluation) {
  const auto begin = std::chrono::steady_clock::now();
  if (avatar.encoder && avatar.encoder->corrects_head_pose(avatar.rig))
    evaluation.tracked_name = "tracked_with_pose";
  for (const RelightSet& set : relight_sets(capture))
    evaluation.relight[set.name] = score_relight(avatar, capture, set);
  evaluation.truth = score_truth(avatar, capture, evaluation.frames);
  evaluation.albedo_error = evaluation.truth ? evaluation.truth->surface.albedo_error
                                             : albedo_error(avatar, capture, evaluation.frames);
  evaluation.edit = measure_edit_accuracy(avatar, edit_views(avatar, evaluation));
  evaluation.seconds +=
      std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

Evaluation evaluate_avatar(const HeadAvatar& avatar, const Capture& capture,
                           const EvaluationOptions& options) {
  Evaluation evaluation = score_frames(avatar, capture, options);
  score_as_a_whole(avatar, capture, evaluation);
  return evaluation;
}

Json Evaluation::metrics() const {
  // The top level is the protocol `tracked`.
  const auto with_net = [&](const ProtocolScores& protocol) {
    Json json = protocol.to_json();
    json["lpips_net"] = lpips_net.empty() ? Json() : Json(lpips_net);
    return json;
  };
  Json json = with_net(tracked);
  json["split"] = "test";
  json["protocol"] = tracked_name;
  json["tracker"] = with_net(tracker);
  if (refined) json["refined"] = with_net(*refined);
  json["relight"] = Json::object();
  for (const auto& [name, scores] : relight) json["relight"][name] = scores.to_json();
  if (truth) json.update(truth->to_json());
  json["albedo_error"] = albedo_error ? Json(*albedo_error) : Json();
  json["edit"] = edit.to_json();
  if (lpips_net.empty()) json["lpips_note"] = lpips_note;
  json["seconds"] = seconds;
  return json;
}

}  // namespace effigy
