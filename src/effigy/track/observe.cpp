#include "effigy/track/observe.h"

#include <algorithm>
#include <cmath>
#include <future>
#include <optional>
#include <utility>

#include "effigy/base/error.h"
#include "effigy/base/log.h"
#include "effigy/base/progress.h"
#include "effigy/base/threads.h"
#include "effigy/track/frame_source.h"
#include "effigy/track/mediapipe.h"

namespace effigy {
namespace {

constexpr int kLeastFrames = 10;       // with a face, to tell identity from expression
constexpr double kMostMissing = 0.2;   // of the frames
constexpr double kSmoothFrames = 1.0;  // sigma of the smoothing over time
constexpr double kSmoothReach = 0.02;  // of the distance between the outer corners of the eyes

double median_eye_span(const std::vector<FaceObservation>& frames) {
  std::vector<double> spans;
  for (const FaceObservation& frame : frames) {
    if (!frame.found) continue;
    const float* right = frame.landmarks.data() + 3 * mediapipe::kOuterCornerRight;
    const float* left = frame.landmarks.data() + 3 * mediapipe::kOuterCornerLeft;
    spans.push_back(std::hypot(right[0] - left[0], right[1] - left[1]));
  }
  if (spans.empty()) return 0;
  const auto middle = spans.begin() + static_cast<std::ptrdiff_t>(spans.size() / 2);
  std::nth_element(spans.begin(), middle, spans.end());
  return *middle;
}

}  // namespace

int VideoObservation::tracked() const {
  return static_cast<int>(std::count_if(frames.begin(), frames.end(),
                                        [](const FaceObservation& frame) { return frame.found; }));
}

void check_observation(const VideoObservation& seen, const std::string& video, bool tolerant) {
  const int total = static_cast<int>(seen.frames.size()), tracked = seen.tracked();
  if (total == 0) throw Error(video + ": the video has no frames; give another video.");
  if (tracked == 0)
    throw Error(video + ": no face was found in any of its " + std::to_string(total) +
                " frames; film one person's head from the front, at least 100 pixels high.");
  if (tracked < kLeastFrames)
    throw Error(video + ": only " + std::to_string(tracked) + " of " + std::to_string(total) +
                " frames show a face, at least " + std::to_string(kLeastFrames) +
                " are needed; give a longer video.");
  const std::string several =
      video + ": " + std::to_string(seen.most_faces) + " people are in the picture at once";
  if (seen.most_faces > 1) {
    if (!tolerant)
      throw Error(several +
                  ", an avatar is of one; crop the video to one person, or follow the largest face "
                  "with --tolerant.");
    log_warning(several + "; the largest face is followed.");
  }
  if (tracked < total) {
    int first = 0;
    while (seen.frames[first].found) ++first;
    const std::string gaps = video + ": " + std::to_string(total - tracked) + " of " +
                             std::to_string(total) + " frames show no face (the first is frame " +
                             std::to_string(first) + ")";
    if (!tolerant && total - tracked > kMostMissing * total)
      throw Error(gaps +
                  "; cut the video to where the face stays in the picture, or leave these frames "
                  "out with --tolerant.");
    log_warning(gaps + "; they are left out of training.");
  }
}

VideoObservation observe_video(const Path& video, const ModelSet& models,
                               const TrackOptions& options,
                               const std::function<void()>& each_frame) {
  FaceTracker tracker(models);
  std::optional<PersonSegmenter> segmenter;
  if (!options.matte) segmenter.emplace(models);
  TorsoFollower torso(segmenter ? &*segmenter : nullptr);
  VideoObservation seen;
  FrameSource source(video, options.most_frames);
  seen.frames_per_second = source.info().frames_per_second;
  seen.landmark_count = tracker.landmark_count();
  int64_t expected = source.info().frames;
  if (options.most_frames > 0 && (expected == 0 || expected > options.most_frames))
    expected = options.most_frames;
  Progress progress("landmarks", "frame", expected);
  struct Beside {
    FaceObservation face;
    TorsoMotion torso;
    PhotoWindow photo;
  };
  std::future<Beside> beside;
  const auto collect = [&] {
    if (!beside.valid()) return;
    Beside done = beside.get();
    seen.frames.push_back(std::move(done.face));
    seen.views.torso.push_back(done.torso);
    seen.views.photos.push_back(std::move(done.photo));
  };
  FrameSource::Frame frame;
  while (source.next(frame)) {
    if (frame.number == 0) {
      seen.width = frame.picture.width;
      seen.height = frame.picture.height;
    } else if (frame.picture.width != seen.width || frame.picture.height != seen.height) {
      throw Error(video.string() + ": the picture changes its size at frame " +
                  std::to_string(frame.number) + "; convert the video to one size.");
    }
    seen.seconds.push_back(frame.seconds);
    FaceObservation located = tracker.locate(frame.picture);
    // Scores, torso and look on another thread, while the next frame's face is located.
    collect();
    beside = std::async(std::launch::async, [&tracker, &torso, picture = std::move(frame.picture),
                                             face = std::move(located)]() mutable {
      const OneThread beside_the_networks;
      tracker.score(face);
      Beside done{
          .face = {}, .torso = torso.follow(picture, face), .photo = photo_window(picture, face)};
      done.face = std::move(face);
      return done;
    });
    progress.update(frame.number + 1);
    if (each_frame) each_frame();
  }
  collect();
  progress.finish();
  seen.most_faces = tracker.most_faces();
  check_observation(seen, video.string(), options.tolerant);
  smooth_landmarks(seen.frames, kSmoothFrames, kSmoothReach * median_eye_span(seen.frames));
  return seen;
}

}  // namespace effigy
