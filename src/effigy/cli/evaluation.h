// effigy eval's work, shared with the demo: metrics.json and report.html of an avatar on a capture.
#pragma once

#include <map>
#include <optional>
#include <string>

#include "effigy/avatar/head_avatar.h"
#include "effigy/capture/capture.h"
#include "effigy/cli/shard.h"
#include "effigy/head/edit_accuracy.h"
#include "effigy/head/evaluate.h"
#include "effigy/head/relight.h"
#include "effigy/head/truth_scores.h"

namespace effigy {

// Distances measured beside the ones that need no network.
struct PerceptualDistances {
  std::vector<ImageDistance> distances;  // "lpips", "lpips_unit_range", "feature_squeezenet10"
  std::string lpips_net;                 // "alex", "vgg" or "squeeze"; empty: left out
  std::string lpips_note = "left out: no backbone weights";  // why it is left out
};

struct EvaluationOptions {
  bool refined = true;  // also the protocol `refined`
  int refine_steps = 60;
  Shard shard;          // which of the frames are scored here
  int most_frames = 0;  // 0: all held-out frames
  std::vector<std::string> lights = {"studio", "overcast", "sunset"};  // relit in the report
  PerceptualDistances perceptual;
};

struct Evaluation {
  std::vector<int> frames;
  ProtocolScores tracker, tracked;  // the same without an encoder
  // What `tracked` is called: "tracked_with_pose" of an encoder that corrects the head's pose too.
  std::string tracked_name = "tracked";
  std::optional<ProtocolScores> refined;
  std::map<std::string, RelightScores> relight;  // synthetic captures only
  std::optional<double> albedo_error;            // mean absolute, sRGB, best scale; where known
  std::optional<TruthScores> truth;              // synthetic captures with layers only
  std::string lpips_net, lpips_note;             // as in PerceptualDistances
  EditAccuracy edit;  // of a checker painted on the albedo, over frames and views
  double seconds = 0;
  Json metrics() const;  // metrics.json
};

// Scores `avatar` on the held-out frames of `capture` (all frames when none are held out): frame by
// frame, ...
Evaluation score_frames(const HeadAvatar& avatar, const Capture& capture,
                        const EvaluationOptions& options);
// ... and by what is no mean over these frames: light, truth and edits.
void score_as_a_whole(const HeadAvatar& avatar, const Capture& capture, Evaluation& evaluation);
// Both.
Evaluation evaluate_avatar(const HeadAvatar& avatar, const Capture& capture,
                           const EvaluationOptions& options);

// The scores of one shard's frames go to OUT/shards; merged, they are what score_frames() finds of
// all frames. Throws Error when shards are missing or belong to another avatar, capture or options.
void write_evaluation_shard(const Evaluation& evaluation, const EvaluationOptions& options,
                            const Capture& capture, const Path& avatar_folder, const Path& out);
Evaluation merge_shards(const HeadAvatar& avatar, const Capture& capture, const Path& avatar_folder,
                        const Path& out);

// Writes OUT/report.html and OUT/metrics.json, each complete or not at all.
void write_evaluation(const Evaluation& evaluation, const HeadAvatar& avatar,
                      const Capture& capture, const Path& avatar_folder,
                      const EvaluationOptions& options, const Path& out);

}  // namespace effigy
