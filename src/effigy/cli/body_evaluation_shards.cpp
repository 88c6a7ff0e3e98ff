// Scores of a body's views, split among machines and put together again.

#include "effigy/base/error.h"
#include "effigy/cli/body_evaluation.h"

namespace effigy {
namespace {

Json to_json(const BodyScore& s) {
  return from_scores({s.psnr, s.ssim, s.flip, s.psnr_inside});
}

BodyScore body_score(const Json& view, const char* field, const Path& file) {
  const std::vector<double> s = to_scores(json_field<Json>(view, field, file), 4, file);
  return {s[0], s[1], s[2], s[3]};
}

Json to_json(const std::optional<SurfaceScores>& s) {
  if (!s) return {};
  return from_scores({s->albedo_error, s->roughness_error, s->normal_degrees, s->depth_error_mm});
}

std::optional<SurfaceScores> surface_scores(const Json& view, const Path& file) {
  const Json json = json_field<Json>(view, "surface", file);
  if (json.is_null()) return std::nullopt;
  const std::vector<double> s = to_scores(json, 4, file);
  return SurfaceScores{s[0], s[1], std::nullopt, s[2], s[3]};
}

ViewScores view_scores(const Json& json, const Path& file) {
  ViewScores scores;
  scores.view = {json_field<int>(json, "frame", file), json_field<int>(json, "camera", file)};
  scores.score = body_score(json, "score", file);
  scores.flat = body_score(json, "mean_colour", file);
  scores.unlit = body_score(json, "left_fully_lit", file);
  scores.distances = to_distances(json, file);
  scores.surface = surface_scores(json, file);
  const std::vector<double> fit = to_scores(json_field<Json>(json, "scale_fit", file), 4, file);
  scores.fit = {fit[0], fit[1]};
  scores.unlit_fit = {fit[2], fit[3]};
  return scores;
}

Json scored_by(const StageCapture& capture, const Path& avatar_folder) {
  return {{"kind", "body"},
          {"avatar", avatar_mark(avatar_folder)},
          {"frames", capture.frames.size()},
          {"cameras", capture.cameras.size()}};
}

}  // namespace

void write_body_shard(const BodyEvaluation& evaluation, const BodyEvaluationOptions& options,
                      const StageCapture& capture, const Path& avatar_folder, const Path& out) {
  Json views = Json::object();
  for (const ViewGroup& group : evaluation.groups)
    for (const ViewScores& scores : group.views)
      views[group.name].push_back(
          {{"frame", scores.view.frame},
           {"camera", scores.view.camera},
           {"score", to_json(scores.score)},
           {"mean_colour", to_json(scores.flat)},
           {"left_fully_lit", to_json(scores.unlit)},
           {"distances", from_distances(scores.distances)},
           {"surface", to_json(scores.surface)},
           {"scale_fit", from_scores({scores.fit.cross, scores.fit.square, scores.unlit_fit.cross,
                                      scores.unlit_fit.square})}});
  Json about = scored_by(capture, avatar_folder);
  about["views"] = options.most_views;
  about["lpips_net"] = evaluation.lpips_net;
  about["lpips_note"] = evaluation.lpips_note;
  write_shard(out, options.shard, about,
              {{"groups", views},
               {"left_lit", evaluation.left_lit},
               {"views_left_out", evaluation.left_out},
               {"seconds", evaluation.seconds}});
}

BodyEvaluation merge_body_shards(BodyAvatar& avatar, const StageCapture& capture,
                                 const Path& avatar_folder, const Path& out) {
  Json about;
  const std::vector<Json> shards = read_shards(out, about);
  const Path file = out / "shards";
  check_shards(about, scored_by(capture, avatar_folder), out);
  BodyEvaluation evaluation;
  evaluation.lpips_net = json_field<std::string>(about, "lpips_net", file);
  evaluation.lpips_note = json_field<std::string>(about, "lpips_note", file);
  std::map<std::string, std::map<std::pair<int, int>, ViewScores>> found;
  for (const Json& shard : shards) {
    evaluation.left_lit = json_field<bool>(shard, "left_lit", file);
    evaluation.left_out += json_field<size_t>(shard, "views_left_out", file);
    evaluation.seconds += json_field<double>(shard, "seconds", file);
    const Json groups = json_field<Json>(shard, "groups", file);
    for (const auto& [name, views] : groups.items())
      for (const Json& view : views) {
        const ViewScores scores = view_scores(view, file);
        found[name][{scores.view.frame, scores.view.camera}] = scores;
      }
  }
  // The order of one run, in which the means are taken.
  size_t total = 0, known = 0;
  for (const ScoredGroup& wanted :
       scored_groups(capture, json_field<size_t>(about, "views", file))) {
    ViewGroup group{wanted.name, wanted.title, {}};
    for (const StageViewKey& key : wanted.views) {
      const auto at = found[wanted.name].find({key.frame, key.camera});
      if (at != found[wanted.name].end()) group.views.push_back(at->second);
    }
    total += wanted.views.size();
    known += group.views.size();
    if (!group.views.empty()) evaluation.groups.push_back(std::move(group));
  }
  if (known + evaluation.left_out != total || evaluation.groups.empty())
    throw Error(file.string() + ": the shards hold " + std::to_string(known) + " of " +
                std::to_string(total) + " views; run them again with the same capture.");
  score_body_relighting(avatar, capture, evaluation);
  return evaluation;
}

}  // namespace effigy
