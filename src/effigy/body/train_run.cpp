// Loop, progress, held-out score, checkpoints, the avatar on disk.

#include "effigy/body/train_run.h"

#include <chrono>
#include <numbers>

#include "effigy/base/log.h"
#include "effigy/base/progress.h"
#include "effigy/base/threads.h"
#include "effigy/body/body_avatar.h"
#include "effigy/body/evaluate.h"
#include "effigy/body/trainer.h"
#include "effigy/learn/training_log.h"

namespace effigy {
namespace {

constexpr size_t kHeldOutViews = 8;
constexpr int kMostReturns = 5;  // to a checkpoint, after the loss exploded

class BodyTrainRun {
 public:
  BodyTrainRun(const StageCapture& capture, const BodyTrainSettings& settings, const Path& out,
               const BodyTrainOptions& options)
      : capture_(capture),
        out_(out),
        options_(options),
        trainer_(capture, settings, options.perceptual) {
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
    if (std::filesystem::exists(progress_path())) {
      const Json before = read_json(progress_path());
      curve_.restore(before);
      seconds_before_ = before.value("seconds", 0.0);
    }
    log_info(format("going on from iteration {}", trainer_.iteration()));
  }

  Json run() {
    const BodyTrainSettings& settings = trainer_.settings();
    try {
      Progress progress("training", "it", settings.iterations, trainer_.iteration());
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
        progress.update(now, format("L1 {:.4f}{}", loss, held_out_text));
      }
    } catch (const Interrupted&) {
      save_progress();
      throw Error("Interrupted at iteration " + std::to_string(trainer_.iteration()) +
                      "; go on with --resume.",
                  Blame::kResource);
    }
    return finish();
  }

 private:
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
      if (++returns_ > kMostReturns || !std::filesystem::exists(checkpoint_path())) throw;
      trainer_.load_checkpoint(checkpoint_path());
      for (int k = 0; k < returns_; ++k) trainer_.change_order();
      log_warning(std::string(problem.what()) + " Going on from iteration " +
                  std::to_string(trainer_.iteration()) + " with other views.");
      return false;
    }
  }

  double held_out_psnr() {
    trainer_.model().networks().set_training(false);
    BodyViewer viewer(trainer_.settings(), trainer_.model(), trainer_.moments());
    std::vector<BodyScore> scores;
    for (const StageViewKey& view : held_out_) scores.push_back(score_of(viewer.draw(view)));
    trainer_.model().networks().set_training(true);
    return mean_score(scores).psnr;
  }

  void save_progress() {
    trainer_.save_checkpoint(checkpoint_path());
    write_json(
        progress_path(),
        {{"seconds", elapsed()}, {"losses", curve_.losses()}, {"heldout", curve_.heldout()}});
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

  Json finish() {
    const double seconds = elapsed();
    const int64_t iterations = trainer_.iteration();
    BodyDriver driver(capture_);
    const Json result = {{"iterations", iterations},
                         {"seconds", seconds},
                         {"iterations_per_second", seconds > 0 ? iterations / seconds : 0.0},
                         {"peak_memory_bytes", peak_memory_bytes()},
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
  BodyTrainer trainer_;
  TrainingCurve curve_;
  std::vector<StageViewKey> held_out_;
  std::chrono::steady_clock::time_point begin_ = std::chrono::steady_clock::now();
  double seconds_before_ = 0;
  int returns_ = 0;
};

}  // namespace

Json train_body(const StageCapture& capture, const BodyTrainSettings& settings, const Path& out,
                const BodyTrainOptions& options) {
  return BodyTrainRun(capture, settings, out, options).run();
}

}  // namespace effigy
