// Loop, progress, held-out score, checkpoints, the avatar on disk.

#include "effigy/body/train_run.h"

#include <algorithm>
#include <chrono>
#include <numbers>
#include <optional>

#include "effigy/base/log.h"
#include "effigy/base/progress.h"
#include "effigy/base/threads.h"
#include "effigy/body/body_avatar.h"
#include "effigy/body/evaluate.h"
#include "effigy/body/fill_maps.h"
#include "effigy/body/trainer.h"
#include "effigy/learn/training_log.h"

namespace effigy {
namespace {

constexpr size_t kHeldOutViews = 8;
constexpr int kMostReturns = 5;  // to a checkpoint, after the loss exploded

class BodyTrainRun {
 public:
  BodyTrainRun(const StageCapture& capture, const BodyTrainSettings& settings, const Path& out,
               const BodyTrainOptions& options, Ranks& ranks)
      : capture_(capture),
        out_(out),
        options_(options),
        ranks_(ranks),
        trainer_(capture, settings, options.perceptual, ranks) {
    if (std::filesystem::exists(out) && !std::filesystem::is_directory(out))
      throw Error("Cannot write " + out.string() +
                  ": a file of that name is in the way; choose another -o.");
    make_folder(out);
    std::vector<int> frames = capture.frames_of(StageSplit::kMotion);
    if (frames.empty()) frames = capture.frames_of(StageSplit::kLights);
    std::vector<int> cameras = capture.test_cameras();
    if (cameras.empty()) cameras = capture.train_cameras();
    if (!frames.empty()) held_out_ = scored_views(capture, frames, cameras, kHeldOutViews);
    if (!options.resume) return;
    trainer_.load_checkpoint(checkpoint_path());
    checkpointed_ = true;
    if (std::filesystem::exists(progress_path())) {
      const Json before = read_json(progress_path());
      curve_.restore(before);
      seconds_before_ = before.value("seconds", 0.0);
    }
    if (first()) log_info(format("going on from iteration {}", trainer_.iteration()));
  }

  Json run() {
    const BodyTrainSettings& settings = trainer_.settings();
    check_same_model();
    try {
      std::optional<Progress> progress;
      if (first()) progress.emplace("training", "it", settings.iterations, trainer_.iteration());
      double loss = 0;
      std::string held_out_text;
      while (trainer_.iteration() < settings.iterations) {
        if (!advance(loss)) continue;
        const int64_t now = trainer_.iteration();
        if (settings.evaluate_every > 0 && now % settings.evaluate_every == 0 &&
            !held_out_.empty()) {
          const double psnr = held_out_psnr();
          curve_.add_heldout(now, psnr);
          held_out_text = format(", held-out PSNR {:.2f} dB", psnr);
        }
        if (now % settings.checkpoint_every == 0) save_progress();
        together(ranks_, [&] {
          if (progress)
            progress->update(now, format("L1 {:.4f}{}", loss, held_out_text));
          else
            throw_if_interrupted();
        });
      }
    } catch (const Interrupted&) {
      save_progress();
      together(ranks_, [&] {
        throw Error("Interrupted at iteration " + std::to_string(trainer_.iteration()) +
                        "; go on with --resume.",
                    Blame::kResource);
      });
    }
    check_same_model();
    const auto memory = static_cast<double>(peak_memory_bytes());
    const std::vector<double> memories = ranks_.gather({&memory, 1});
    Json result;
    together(ranks_, [&] {
      if (first()) result = finish(*std::max_element(memories.begin(), memories.end()));
    });
    return result;
  }

 private:
  bool first() const { return ranks_.rank() == 0; }
  // Processes on different processors round differently; here it is found out.
  void check_same_model() {
    if (ranks_.size() > 1)
      check_alike(ranks_, trainer_.fingerprint(),
                  "do not hold the same model at iteration " +
                      std::to_string(trainer_.iteration()) +
                      "; use nodes with the same processor, one version of the program, the same "
                      "--threads and the same capture.");
  }
  Path checkpoint_path() const { return out_ / "checkpoint.safetensors"; }
  Path progress_path() const { return out_ / "checkpoint.json"; }
  double elapsed() const {
    return seconds_before_ +
           std::chrono::duration<double>(std::chrono::steady_clock::now() - begin_).count();
  }

  // False when the loss exploded and the run went back.
  bool advance(double& loss) {
    try {
      const BodyLossValues losses = trainer_.step();
      curve_.add(trainer_.iteration(), losses);
      loss += 0.05 * (losses.at("l1") - loss);
      return true;
    } catch (const Diverged& problem) {
      if (++returns_ > kMostReturns || !checkpointed_) throw;
      together(ranks_, [&] { trainer_.load_checkpoint(checkpoint_path()); });
      for (int k = 0; k < returns_; ++k) trainer_.change_order();
      if (first())
        log_warning(std::string(problem.what()) + " Going on from iteration " +
                    std::to_string(trainer_.iteration()) + " with other views.");
      return false;
    }
  }

  // The processes take turns at the views.
  double held_out_psnr() {
    std::vector<double> mine(held_out_.size());
    together(ranks_, [&] {
      trainer_.model().networks().set_training(false);
      BodyViewer viewer(trainer_.settings(), trainer_.model(), trainer_.moments());
      const auto stride = static_cast<size_t>(ranks_.size());
      for (auto k = static_cast<size_t>(ranks_.rank()); k < mine.size(); k += stride)
        mine[k] = score_of(viewer.draw(held_out_[k])).psnr;
      trainer_.model().networks().set_training(true);
    });
    const std::vector<double> all = ranks_.gather(mine);
    std::vector<BodyScore> scores(mine.size());
    for (size_t k = 0; k < scores.size(); ++k)
      scores[k].psnr = all[k % static_cast<size_t>(ranks_.size()) * scores.size() + k];
    return mean_score(scores).psnr;
  }

  void save_progress() {
    check_same_model();
    together(ranks_, [&] {
      if (!first()) return;
      trainer_.save_checkpoint(checkpoint_path());
      write_json(
          progress_path(),
          {{"seconds", elapsed()}, {"losses", curve_.losses()}, {"heldout", curve_.heldout()}});
    });
    checkpointed_ = true;
  }

  Json provenance() const {
    return {{"source", capture_.source},
            {"licence", capture_.licence},
            {"consent", options_.consent.empty() ? capture_.consent : options_.consent},
            {"rig", capture_.rig.kind},
            {"rig_licence", capture_.rig.licence},
            {"made_by", "Effigy " EFFIGY_VERSION},
            {"synthetic", true}};
  }

  // Mean radiance of all lamps together at the stage's middle: what renders are exposed to.
  double light_level() const {
    double sum = 0;
    const Vec3f& center = trainer_.source().center();
    for (const StageLight& light : capture_.lights)
      sum += luminance(light.intensity.x(), light.intensity.y(), light.intensity.z()) /
             (light.position - center).squaredNorm();
    return sum > 0 ? sum / (4 * std::numbers::pi) : 1.0;
  }

  // The training camera that sees the body most from the front.
  const Camera& front_camera() const {
    const Vec3d center = trainer_.source().center().cast<double>();
    const Camera* best = nullptr;
    double most = -2;
    for (const int index : capture_.train_cameras()) {
      const Camera& camera = capture_.cameras[static_cast<size_t>(index)].camera;
      const double facing = (camera.center() - center).normalized().dot(Vec3d(0.2, 0.05, 1));
      if (facing <= most) continue;
      most = facing;
      best = &camera;
    }
    return *best;
  }

  Json finish(double peak_memory) {
    const double seconds = elapsed();
    const int64_t iterations = trainer_.iteration();
    trainer_.model().networks().set_training(false);
    fill_hidden_maps(trainer_.moments(), trainer_.model());
    BodyDriver driver(capture_);
    const Json result = {{"iterations", iterations},
                         {"seconds", seconds},
                         {"iterations_per_second", seconds > 0 ? iterations / seconds : 0.0},
                         {"peak_memory_bytes", static_cast<uint64_t>(peak_memory)},
                         {"processes", ranks_.size()},
                         {"threads", thread_count()},
                         {"gaussians", trainer_.model().texels().count()},
                         {"keypoints_from_rig_worst_m", driver.worst()},
                         {"settings", to_json(trainer_.settings())},
                         {"losses", curve_.losses()},
                         {"heldout", curve_.heldout()}};
    Track track;
    track.frames_per_second = capture_.frames_per_second;
    for (const StageFrame& frame : capture_.frames) track.numbers.push_back(frame.number);
    track.poses = capture_.poses;
    Json info = {{"provenance", provenance()},
                 {"light_level", light_level()},
                 {"training", {{"iterations", iterations}, {"seconds", seconds}}}};
    const BodyAvatar avatar{capture_.rig,
                            std::move(trainer_.model()),
                            std::move(driver),
                            trainer_.settings(),
                            capture_.display,
                            front_camera(),
                            {{"train", std::move(track)}},
                            std::move(info)};
    // The folder holds the checkpoint of this run until everything else is complete on disk.
    write_json(out_ / "training.json", result);
    write_body_avatar(avatar, out_);
    std::error_code ignored;
    std::filesystem::remove(checkpoint_path(), ignored);
    std::filesystem::remove(progress_path(), ignored);
    return result;
  }

  const StageCapture& capture_;
  Path out_;
  BodyTrainOptions options_;
  Ranks& ranks_;
  BodyTrainer trainer_;
  TrainingCurve curve_;
  std::vector<StageViewKey> held_out_;
  std::chrono::steady_clock::time_point begin_ = std::chrono::steady_clock::now();
  double seconds_before_ = 0;
  int returns_ = 0;
  bool checkpointed_ = false;  // a checkpoint of this run is there to go back to
};

}  // namespace

Json train_body(const StageCapture& capture, const BodyTrainSettings& settings, const Path& out,
                const BodyTrainOptions& options, Ranks& ranks) {
  // Until here the processes have nothing in common but what they read.
  std::optional<BodyTrainRun> run;
  together(ranks, [&] { run.emplace(capture, settings, out, options, ranks); });
  return run->run();
}

}  // namespace effigy
