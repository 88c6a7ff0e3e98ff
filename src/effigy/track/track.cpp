#include "effigy/track/track.h"

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <future>

#include "effigy/base/log.h"
#include "effigy/base/threads.h"
#include "effigy/capture/capture.h"
#include "effigy/image/video.h"
#include "effigy/people/builtin_head.h"
#include "effigy/rig/canonical_face.h"
#include "effigy/rig/embedding.h"
#include "effigy/rig/rig_file.h"
#include "effigy/track/capture_writer.h"
#include "effigy/track/fit.h"
#include "effigy/track/observe.h"
#include "effigy/track/track_report.h"

namespace effigy {
namespace {

// Seconds of each stage, in order.
class StageClock {
 public:
  void stage(const std::string& name) {
    const auto now = std::chrono::steady_clock::now();
    const double seconds = std::chrono::duration<double>(now - last_).count();
    stages_[name] = seconds;
    total_ += seconds;
    last_ = now;
  }
  double total() const { return total_; }
  Json json() const { return stages_; }

 private:
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
  Json stages_ = Json::object();
  double total_ = 0;
};

// --rig, else ICT-FaceKit in $EFFIGY_DATA, else the built-in head.
Rig choose_rig(const TrackOptions& options, const ModelSet& models) {
  const Path geometry = models.landmarks_path.parent_path();
  if (options.rig) return load_rig(*options.rig, geometry);
  const char* data = std::getenv("EFFIGY_DATA");
  if (data != nullptr) {
    const Path folder = Path(data) / "face/ict_facekit";
    if (std::filesystem::is_directory(folder)) return load_rig(folder, geometry);
  }
  Rig rig = builtin_head_rig();
  // It stands on the 68 landmarks alone, unless the networks' canonical face is there.
  const CanonicalFace face = find_canonical_face(geometry);
  if (!face.empty()) rig.mediapipe = embed_canonical(rig, face);
  return rig;
}

double median_of_found(std::vector<double> values) {
  values.erase(std::remove_if(values.begin(), values.end(), [](double v) { return v < 0; }),
               values.end());
  if (values.empty()) return 0;
  auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// The network's landmarks in pixels of the capture; frames without a face keep zeros.
void store_landmarks(const VideoObservation& seen, const CropBox& crop, Capture& capture) {
  capture.landmark_count = seen.landmark_count;
  capture.landmarks.assign(seen.frames.size() * seen.landmark_count * 2, 0.0f);
  const double sx = crop.out_width / crop.width, sy = crop.out_height / crop.height;
  for (size_t f = 0; f < seen.frames.size(); ++f) {
    if (!seen.frames[f].found) continue;
    for (int l = 0; l < seen.landmark_count; ++l) {
      float* out = &capture.landmarks[2 * (f * seen.landmark_count + l)];
      out[0] = static_cast<float>((seen.frames[f].landmarks[3 * l] - crop.x) * sx);
      out[1] = static_cast<float>((seen.frames[f].landmarks[3 * l + 1] - crop.y) * sy);
    }
  }
}

// The networks' scores; frames without a face keep zeros. None when no network gives any.
void store_scores(const VideoObservation& seen, Capture& capture) {
  for (const FaceObservation& frame : seen.frames)
    capture.score_count = std::max(capture.score_count, static_cast<int>(frame.scores.size()));
  const auto count = static_cast<size_t>(capture.score_count);
  capture.scores.assign(seen.frames.size() * count, 0.0f);
  for (size_t f = 0; f < seen.frames.size(); ++f)
    std::copy(seen.frames[f].scores.begin(), seen.frames[f].scores.end(),
              capture.scores.begin() + static_cast<std::ptrdiff_t>(f * count));
}

}  // namespace

Json track_video(const Path& video, const Path& output, const TrackOptions& options) {
  FolderWriter folder(output, "capture.json");
  const ModelSet models = find_models(options.models, !options.matte.has_value());
  { const VideoReader readable(video); }  // before anything that takes time
  if (options.matte) list_own_mattes(*options.matte, 0);
  StageClock clock;
  Capture capture;
  capture.source = video.filename().string();
  capture.consent = options.consent;
  capture.licence = options.licence;
  // The rig is prepared while the networks see the first frames; a bad one ends the pass early.
  std::future<Rig> rig = std::async(std::launch::async, [&] {
    const OneThread beside_the_networks;
    return choose_rig(options, models);
  });
  const auto take_rig = [&] {
    if (!rig.valid()) return;
    capture.rig = rig.get();
    log_info("tracking with the rig " + capture.rig.kind + " and " + models.description());
  };
  const VideoObservation seen = observe_video(video, models, options, [&] {
    if (rig.valid() && rig.wait_for(std::chrono::seconds(0)) == std::future_status::ready)
      take_rig();
  });
  take_rig();
  if (options.matte) list_own_mattes(*options.matte, seen.frames.size());
  clock.stage("rig and landmarks");
  const FitResult fit = fit_rig(capture.rig, seen.frames, seen.views, seen.width, seen.height, {});
  shift_joint(capture.rig, fit.identity, std::max(capture.rig.joint("neck"), 0), fit.neck_shift);
  clock.stage("fit");

  const CropBox crop = choose_crop(capture.rig, fit, seen, options);
  capture.frames_per_second = seen.frames_per_second > 0 ? seen.frames_per_second : 25;
  capture.identity = fit.identity;
  capture.poses = fit.poses;
  capture.camera =
      fit_camera(fit.focal, seen.width, seen.height)
          .cropped(crop.x, crop.y, crop.width, crop.height, crop.out_width, crop.out_height);
  store_landmarks(seen, crop, capture);
  store_scores(seen, capture);
  write_frames(video, models, options, seen, fit, crop, folder.dir(), capture);
  clock.stage("mattes and frames");
  split_test_frames(capture, options.test_frames);
  if (capture.train_frames().size() < 2)
    log_warning("fewer than 2 tracked training frames: this capture cannot be trained on");

  const double to_512 = 512 / std::max(crop.width, crop.height);
  const Json summary = {
      {"frames", seen.frames.size()},
      {"tracked", seen.tracked()},
      {"rig", capture.rig.kind},
      {"networks", models.description()},
      {"landmark_error_median_px", to_512 * median_of_found(fit.error)},
      {"heldout_landmark_error_median_px", to_512 * median_of_found(fit.heldout_error)},
      {"milliseconds_per_frame", 1000 * clock.total() / static_cast<double>(seen.frames.size())},
      {"focal_px", capture.camera.fx},
      {"size", {capture.camera.width, capture.camera.height}},
      {"most_faces", seen.most_faces},
      {"seconds", clock.json()}};
  capture.extra = {{"track", summary}};
  write_capture(capture, folder.dir());
  write_json(folder.dir() / "track.json", summary);
  write_track_report(capture, fit, to_512, summary, folder.dir());
  folder.commit();
  return summary;
}

}  // namespace effigy
