// The views of a stage capture as a body's training and scoring use them. Captures may be larger
// than memory: images stay compressed on disk and are decoded ahead by threads of their own.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "effigy/base/error.h"
#include "effigy/body/stage_schedule.h"
#include "effigy/capture/stage_capture.h"
#include "effigy/image/colour.h"
#include "effigy/light/point_light.h"

namespace effigy {

// What all cameras see alike.
struct StageMoment {
  int frame = 0;
  std::vector<float> vertices;                        // 3V, metres, world: the tracked mesh
  std::vector<float> body_keypoints, face_keypoints;  // 3K, metres, in the root's, the head's frame
  // The frame's lights at their amounts, with falloff; none under an environment. Intensities are
  // those at the stage's centre, so that without falloff they are right there.
  PointLights lights;
  bool fully_lit = false;
  Path environment;  // equirectangular EXR (its full path); empty when points light the frame
};

struct StageView {
  uint64_t number = 0;  // in the schedule
  int frame = 0, camera = 0;
  int left = 0, top = 0;    // of the picture in the camera's image
  Camera view;              // of the picture
  Planes image;             // 3 planes, as encoded (the capture's display transform), on black
  std::vector<float> mask;  // 1 a pixel, 1 = body
  // 3 planes, linear: what fully lit pictures of cameras with a background photograph show instead
  // of black; else empty.
  Planes background;
  std::shared_ptr<const StageMoment> moment;
};

// Linear values of the 256 encoded ones; of reinhard-srgb at most 100.
std::array<float, 256> linear_table(DisplayTransform display);

// Takes a view's background away: its picture times the mask, on black.
void put_on_black(StageView& view);

struct StageCrop {
  // Side of a square in pixels (less where the image is smaller) at a random place among those that
  // show a random pixel of the body. 0: all of the body.
  int side = 0;
  // Pixels kept around all of the body; negative: the whole image.
  int border = -1;
  uint64_t seed = 0;  // with the view's number
};

// Reads single moments and views. Safe from many threads. The capture must outlive it and its
// copies.
class StageSource {
 public:
  // Throws Error when a keypoint's frame has no inverse.
  explicit StageSource(const StageCapture& capture);

  const StageCapture& capture() const { return capture_; }
  // The middle of the stage: the mean of the body's keypoints over all frames (where there are
  // none, of the lights).
  const Vec3f& center() const { return center_; }
  // Both throw Error naming the file that is missing or damaged.
  StageMoment moment(int frame) const;
  StageView view(const StageViewKey& key, const StageCrop& crop, uint64_t number = 0) const;

 private:
  const StageCapture& capture_;
  Vec3f center_;
};

// Views with missing or damaged files: never a reason to stop, unless they are many.
class LeftOutViews {
 public:
  // One more, whose reading threw `error`; the first is told as a warning. Rethrows what is not the
  // files' fault; throws Error naming the first when more than a tenth of `of` views are left out.
  void add(const Error& error, size_t of);
  size_t count() const { return count_; }
  const std::string& first() const { return first_; }

 private:
  size_t count_ = 0;
  std::string first_;
};

struct StageViewsOptions {
  StageCrop crop;
  int threads = 1;      // that decode ahead; 0: the caller's
  int ahead = 4;        // views decoded and not yet taken, at most
  bool endless = true;  // epoch after epoch; else the schedule once
  // Only every so-manieth view from the first on: one process's share of many (learn/ranks.h).
  uint64_t stride = 1;
};

// The views of a schedule, one after the other: the same for every number of threads.
//
// A view with a missing or damaged file is left out: an endless schedule shows another one of its
// epoch in its place (so that view `number` does not depend on what came before), a finite one goes
// on. The first one is told as a warning, all are counted.
class StageViews {
 public:
  StageViews(StageSource source, StageSchedule schedule, const StageViewsOptions& options,
             uint64_t first = 0);
  ~StageViews();
  StageViews(StageViews&&) noexcept;
  StageViews& operator=(StageViews&&) noexcept;

  // Empty after the last one. Throws Error naming the first damaged file when more than a tenth of
  // the views tried (of the first hundred, as long as fewer were tried) could not be read.
  std::optional<StageView> next();
  // Number of the view that next() will return: what a checkpoint stores.
  uint64_t number() const;
  // Different views found missing or damaged so far.
  size_t missing() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace effigy
