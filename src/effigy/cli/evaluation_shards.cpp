// Scores of a head's frames, split among machines and put together again.

#include <map>

#include "effigy/base/error.h"
#include "effigy/cli/evaluation.h"

namespace effigy {
namespace {

// Frame by frame; poses are not kept where they are the capture's.
Json to_json(const ProtocolScores& scores, bool poses) {
  Json frames = Json::array();
  for (size_t i = 0; i < scores.frames.size(); ++i) {
    const FrameScore& s = scores.frames[i];
    Json entry = {{"frame", s.frame},
                  {"score", from_scores({s.psnr, s.psnr_foreground, s.ssim, s.coverage, s.flip})},
                  {"distances", from_distances(s.distances)}};
    if (poses) {
      const RigPose& pose = scores.poses[i];
      entry["pose"] = {{"expression", pose.expression},
                       {"joint_rotation", pose.joint_rotation},
                       {"translation", pose.translation}};
    }
    frames.push_back(std::move(entry));
  }
  return frames;
}

using Found = std::map<int, std::pair<FrameScore, RigPose>>;

// `poses`: those of the frames unless the entries have their own.
void find(const Json& frames, const std::vector<RigPose>& poses, const Path& file, Found& found) {
  for (const Json& entry : frames) {
    const int frame = json_field<int>(entry, "frame", file);
    if (frame < 0 || frame >= static_cast<int>(poses.size()))
      throw Error(file.string() + ": a shard scores frame " + std::to_string(frame) +
                  ", which the capture does not have; run it again.");
    RigPose pose = poses[static_cast<size_t>(frame)];
    if (entry.contains("pose")) {
      const Json& own = entry["pose"];
      const auto values = [&](const char* field, size_t count) {
        const std::vector<double> wide = to_scores(json_field<Json>(own, field, file), count, file);
        return std::vector<float>(wide.begin(), wide.end());
      };
      pose.expression = values("expression", pose.expression.size());
      pose.joint_rotation = values("joint_rotation", pose.joint_rotation.size());
      const std::vector<float> moved = values("translation", pose.translation.size());
      std::copy(moved.begin(), moved.end(), pose.translation.begin());
    }
    const std::vector<double> s = to_scores(json_field<Json>(entry, "score", file), 5, file);
    FrameScore score{frame, s[0], s[1], s[2], s[3], s[4], {}};
    score.distances = to_distances(entry, file);
    found[frame] = {std::move(score), std::move(pose)};
  }
}

ProtocolScores in_order(const Found& found) {
  ProtocolScores scores;
  for (const auto& [frame, scored] : found) {
    scores.frames.push_back(scored.first);
    scores.poses.push_back(scored.second);
  }
  return scores;
}

Json scored_by(const Rig& rig, const Capture& capture, const Path& avatar_folder) {
  return {{"kind", "head"},
          {"avatar", avatar_mark(avatar_folder)},
          {"rig", rig.kind},
          {"frames", capture.frames.size()}};
}

}  // namespace

void write_evaluation_shard(const Evaluation& evaluation, const EvaluationOptions& options,
                            const Capture& capture, const Path& avatar_folder, const Path& out) {
  Json about = scored_by(capture.rig, capture, avatar_folder);
  about["most_frames"] = options.most_frames;
  about["refine_steps"] = options.refined ? options.refine_steps : 0;
  about["lpips_net"] = evaluation.lpips_net;
  about["lpips_note"] = evaluation.lpips_note;
  Json scores = {{"tracker", to_json(evaluation.tracker, false)},
                 {"tracked", to_json(evaluation.tracked, true)},
                 {"seconds", evaluation.seconds}};
  if (evaluation.refined) scores["refined"] = to_json(*evaluation.refined, true);
  write_shard(out, options.shard, about, std::move(scores));
}

Evaluation merge_shards(const HeadAvatar& avatar, const Capture& capture, const Path& avatar_folder,
                        const Path& out) {
  Json about;
  const std::vector<Json> shards = read_shards(out, about);
  const Path file = out / "shards";
  check_shards(about, scored_by(avatar.rig, capture, avatar_folder), out);
  Evaluation evaluation;
  evaluation.lpips_net = json_field<std::string>(about, "lpips_net", file);
  evaluation.lpips_note = json_field<std::string>(about, "lpips_note", file);
  Found tracker, tracked, refined;
  for (const Json& shard : shards) {
    find(json_field<Json>(shard, "tracker", file), capture.poses, file, tracker);
    find(json_field<Json>(shard, "tracked", file), capture.poses, file, tracked);
    if (shard.contains("refined")) find(shard["refined"], capture.poses, file, refined);
    evaluation.seconds += json_field<double>(shard, "seconds", file);
  }
  // Frames are scored in ascending order.
  for (const auto& [frame, scored] : tracker) evaluation.frames.push_back(frame);
  evaluation.tracker = in_order(tracker);
  evaluation.tracked = in_order(tracked);
  if (!refined.empty()) evaluation.refined = in_order(refined);
  if (tracker.empty() || tracked.size() != tracker.size() ||
      (!refined.empty() && refined.size() != tracker.size()))
    throw Error(file.string() +
                ": the shards do not hold the same frames for all protocols; run "
                "them again.");
  return evaluation;
}

}  // namespace effigy
