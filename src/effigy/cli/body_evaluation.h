// effigy eval's work for bodies, shared with the demo: metrics.json and report.html of a body
// avatar on a light-stage capture.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "effigy/body/body_avatar.h"
#include "effigy/body/evaluate.h"
#include "effigy/body/truth_scores.h"
#include "effigy/cli/evaluation.h"
#include "effigy/cli/shard.h"

namespace effigy {

struct BodyEvaluationOptions {
  size_t most_views = 48;  // of each group; 0: all
  Shard shard;             // which of them are scored here
  PerceptualDistances perceptual;
};

struct ViewScores {
  StageViewKey view;
  BodyScore score;
  std::map<std::string, double> distances;
  BodyScore flat;   // the body in one colour: the mean of the fully lit training views
  BodyScore unlit;  // the same view left in full light
  std::optional<SurfaceScores> surface;  // synthetic captures with layers
  ScaleFit fit, unlit_fit;               // of drawn towards true values
};

// What was held out, each group on cameras that were held out too.
struct ViewGroup {
  std::string name, title;
  std::vector<ViewScores> views;
  BodyScore mean(BodyScore ViewScores::*which = &ViewScores::score) const;
  std::map<std::string, double> mean_distances() const;
  std::optional<SurfaceScores> mean_surface() const;  // over views
};

struct BodyEvaluation {
  std::vector<ViewGroup> groups;  // "view", "light", "motion", "environment"; those there are
  std::map<std::string, RelightScores> relight;  // by environment, of the last group
  std::string lpips_net, lpips_note;
  bool left_lit = false;  // the capture has a fully lit frame, so that views were left in its light
  size_t left_out = 0;    // views with missing or damaged files
  double seconds = 0;
  const ViewGroup* group(const std::string& name) const;  // null when there is none
  Json metrics() const;                                   // metrics.json
};

// What is scored of a capture, at most `most_views` of each group.
struct ScoredGroup {
  std::string name, title;
  std::vector<StageViewKey> views;
};
std::vector<ScoredGroup> scored_groups(const StageCapture& capture, size_t most_views);

// Scores view by view, ... Throws Error when capture and avatar have different meshes or keypoints.
BodyEvaluation score_body_views(BodyAvatar& avatar, const StageCapture& capture,
                                const BodyEvaluationOptions& options);
// ... and what needs all views of an environment: relighting after one scale.
void score_body_relighting(BodyAvatar& avatar, const StageCapture& capture,
                           BodyEvaluation& evaluation);
// Both.
BodyEvaluation evaluate_body(BodyAvatar& avatar, const StageCapture& capture,
                             const BodyEvaluationOptions& options);

// The scores of one shard go to OUT/shards; merged, they are those of a run that was not split.
// Throws Error when shards are missing or belong to another avatar, capture or options.
void write_body_shard(const BodyEvaluation& evaluation, const BodyEvaluationOptions& options,
                      const StageCapture& capture, const Path& avatar_folder, const Path& out);
BodyEvaluation merge_body_shards(BodyAvatar& avatar, const StageCapture& capture,
                                 const Path& avatar_folder, const Path& out);

// Writes OUT/report.html and OUT/metrics.json, each complete or not at all.
void write_body_evaluation(const BodyEvaluation& evaluation, BodyAvatar& avatar,
                           const StageCapture& capture, const Path& avatar_folder, const Path& out);

}  // namespace effigy
