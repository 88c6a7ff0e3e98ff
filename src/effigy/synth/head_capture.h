// Captures of the built-in head, or of the user's own, with known answers (docs/synth.md): a
// talking head seen by one camera, every layer of every frame, and the held-out frames under other
// lights.
#pragma once

#include <string>
#include <vector>

#include "effigy/base/file.h"
#include "effigy/rig/rig.h"

namespace effigy {

// What the images show: three levels that separate the causes of a relighting error.
enum class HeadTruth {
  kSplitSum,    // the program's own deferred shading on the true surface
  kUnshadowed,  // the material model integrated over all of the light, nothing in its way
  kPathTraced,  // shadows and interreflection too
};
HeadTruth head_truth_from_name(const std::string& name);  // throws Error
std::string to_string(HeadTruth truth);

struct SynthHeadOptions {
  int frames = 96;
  int size = 384;  // pixels a side
  double frames_per_second = 30;
  HeadTruth truth = HeadTruth::kPathTraced;
  int samples = 64;  // a pixel; split-sum uses 16 at most
  int bounces = 8;
  bool subsurface = false;  // light spreads below the skin; path-traced truth only
  int texture_size = 1024;
  double distance = 1.0;         // metres from camera to the head's middle
  uint64_t subject = 1;          // who: 1 to 5 are the standard subjects (docs/people.md)
  std::string head;              // the user's own instead (people/user_head.h); empty: built-in
  std::string consent;           // what a real person agreed to; empty: not stated
  uint64_t seed = 1;             // of the performance and the noise
  std::string light = "studio";  // a built-in light or an environment file: the capture's light
  std::vector<std::string> relight = {"overcast", "sunset", "window"};  // of the held-out frames
  int relight_frames = 4;                                               // per light; -1: all
  bool layers = true;  // write the truth of every layer
  // Albedo images for training's prior: "none", "truth" or "degraded" (synth/prior_image.h).
  std::string albedo_prior = "none";
  // Defects of the training frames; the held-out frames and all truth stay clean.
  double noise = 0;           // standard deviation of the encoded values
  int compression = 0;        // JPEG quality 1..100; 0: none
  double tracking_error = 0;  // 1: about 1 mm, half a degree, 0.03 of an expression
};

struct SynthHeadResult {
  int frames = 0, images = 0;  // images: with those under other lights
  double seconds = 0, samples_per_second = 0;
};

// Writes a whole capture folder (docs/formats.md). An existing capture there is replaced; any other
// folder that is not empty is refused.
SynthHeadResult synth_head_capture(const SynthHeadOptions& options, const Path& folder);

// PSNR under one light, as the capture holds its images but without defects, against the same
// frames with `factor` times the samples and other random numbers.
struct HeadNoise {
  std::string light;
  double psnr = 0, least = 0, foreground = 0;  // mean and least frame; mean over the matte alone
};
// `frames` moments evenly over the performance, under the capture's light and those of the
// relighting truth.
std::vector<HeadNoise> synth_head_noise(const SynthHeadOptions& options, int factor, int frames);

// The performance: talking, blinks, brows, gaze and head turns, smooth in time. Expressions that
// the rig does not have are left out, but speech then opens a jaw that is a joint, gaze without eye
// joints moves the eyeLook shapes, and a shape of both sides stands for a pair.
RigPose performance_pose(const Rig& rig, double seconds, uint64_t seed);

}  // namespace effigy
