// The whole training run: loop, progress, held-out score, checkpoints, the avatar on disk.

#include <chrono>

#include "effigy/base/log.h"
#include "effigy/base/progress.h"
#include "effigy/base/threads.h"
#include "effigy/head/evaluate.h"
#include "effigy/head/trainer.h"
#include "effigy/learn/training_log.h"

namespace effigy {
namespace {

class TrainRun {
 public:
  TrainRun(const Capture& capture, const TrainSettings& settings, const Path& out,
           const TrainOptions& options)
      : capture_(capture), out_(out), options_(options), trainer_(capture, settings) {
    if (std::filesystem::exists(out) && !std::filesystem::is_directory(out))
      throw Error("Cannot write " + out.string() +
                  ": a file of that name is in the way; choose another -o.");
    make_folder(out);
    if (options.resume) {
      trainer_.load_checkpoint(checkpoint_path());
      if (std::filesystem::exists(progress_path())) {
        const Json before = read_json(progress_path());
        curve_.restore(before);
        seconds_before_ = before.value("seconds", 0.0);
      }
      log_info(format("going on from iteration {}", trainer_.iteration()));
    }
  }

  Json run() {
    const TrainSettings& settings = trainer_.settings();
    const std::vector<int> held_out = spread_frames(capture_.test_frames(), 8);
    const auto begin = std::chrono::steady_clock::now();
    const auto elapsed = [&] {
      return seconds_before_ +
             std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    };
    const int64_t first = trainer_.iteration();
    try {
      Progress progress("training", "it", settings.iterations, first);
      double loss = 0;
      std::string held_out_text;
      while (trainer_.iteration() < settings.iterations) {
        const LossValues losses = trainer_.step();
        curve_.add(trainer_.iteration(), losses);
        loss += 0.05 * ((losses.count("l1") ? losses.at("l1") : 0) - loss);
        if (settings.evaluate_every > 0 && !held_out.empty() &&
            trainer_.iteration() % settings.evaluate_every == 0) {
          const double psnr = evaluate_tracked(trainer_.avatar(), capture_, held_out).mean().psnr;
          curve_.add_heldout(trainer_.iteration(), psnr);
          held_out_text = format(", held-out PSNR {:.2f} dB", psnr);
        }
        if (trainer_.iteration() % settings.checkpoint_every == 0) save_progress(elapsed());
        progress.update(trainer_.iteration(), format("L1 {:.4f}{}", loss, held_out_text));
      }
    } catch (const Interrupted&) {
      save_progress(elapsed());
      throw Error("Interrupted at iteration " + std::to_string(trainer_.iteration()) +
                      "; go on with --resume.",
                  Blame::kResource);
    }
    return finish(elapsed());
  }

 private:
  Path checkpoint_path() const { return out_ / "checkpoint.safetensors"; }
  Path progress_path() const { return out_ / "checkpoint.json"; }

  void save_progress(double seconds) {
    trainer_.save_checkpoint(checkpoint_path());
    write_json(progress_path(),
               {{"seconds", seconds}, {"losses", curve_.losses()}, {"heldout", curve_.heldout()}});
  }

  Json finish(double seconds) {
    HeadAvatar avatar = trainer_.finished_avatar();
    if (!options_.consent.empty()) avatar.info["provenance"]["consent"] = options_.consent;
    const int64_t iterations = trainer_.iteration();
    const Json result = {{"iterations", iterations},
                         {"seconds", seconds},
                         {"iterations_per_second", seconds > 0 ? iterations / seconds : 0.0},
                         {"peak_memory_bytes", peak_memory_bytes()},
                         {"threads", thread_count()},
                         {"settings", to_json(trainer_.settings())},
                         {"losses", curve_.losses()},
                         {"heldout", curve_.heldout()}};
    avatar.info["training"] = {{"iterations", iterations}, {"seconds", seconds}};
    // The folder holds the checkpoint of this run until everything else is complete on disk.
    write_json(out_ / "training.json", result);
    write_head_avatar(avatar, out_);
    std::error_code ignored;
    std::filesystem::remove(checkpoint_path(), ignored);
    std::filesystem::remove(progress_path(), ignored);
    return result;
  }

  const Capture& capture_;
  Path out_;
  TrainOptions options_;
  HeadTrainer trainer_;
  TrainingCurve curve_;
  double seconds_before_ = 0;
};

}  // namespace

Json train_head(const Capture& capture, const TrainSettings& settings, const Path& out,
                const TrainOptions& options) {
  return TrainRun(capture, settings, out, options).run();
}

}  // namespace effigy
