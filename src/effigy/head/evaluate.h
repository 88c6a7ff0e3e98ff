// Scores an avatar against a capture's held-out frames, under named protocols:
//   tracker  rig parameters from tracking alone, nothing fitted to the test image
//   tracked  these as the avatar's encoder corrects them, nothing fitted to the test image; tracker
//            without an encoder
//   refined  pose and expression refined against the test image with the avatar frozen
#pragma once

#include <functional>
#include <map>
#include <string>
#include <vector>

#include "effigy/avatar/renderer.h"
#include "effigy/capture/capture.h"
#include "effigy/head/frames.h"

namespace effigy {

// A distance that needs more than this room has: LPIPS and the like (infer/perceptual.h).
struct ImageDistance {
  std::string name;  // as in metrics.json: "lpips", "feature_squeezenet10", ...
  // Both images 8-bit sRGB values on black, in [0, 1].
  std::function<double(const Image& truth, const Image& rendered)> between;
};

struct FrameScore {
  int frame = 0;  // index into capture.frames
  double psnr = 0, psnr_foreground = 0, ssim = 0, coverage = 0, flip = 0;
  std::map<std::string, double> distances;  // by ImageDistance::name
};

struct ProtocolScores {
  std::vector<FrameScore> frames;
  std::vector<RigPose> poses;  // used for each frame
  FrameScore mean() const;
  // design names: frames psnr psnr_foreground ssim coverage flip lpips feature_squeezenet10; the
  // last two are null when they were not measured.
  Json to_json() const;
};

// Both images as 8-bit values on black. `neck_row`: pixel row of the neck line (image height:
// none).
FrameScore score_frame(const Planes& colour, const Planes& gbuffer, const TargetFrame& target,
                       double neck_row, const std::vector<ImageDistance>& distances = {});
// Lowest image row that still counts as head: the highest point of the projected neck ring.
double neck_row(const HeadAvatar& avatar, const std::vector<float>& vertices, const Camera& camera);

// Throws Error unless the capture's rig has the avatar's expressions and joints.
void check_rigs_agree(const HeadAvatar& avatar, const Capture& capture);

// A frame's pose under the protocol `tracked`.
RigPose tracked_pose(const HeadAvatar& avatar, const Capture& capture, int frame);

// The protocols `tracker` ...
ProtocolScores evaluate_tracker(const HeadAvatar& avatar, const Capture& capture,
                                const std::vector<int>& frames,
                                const std::vector<ImageDistance>& distances = {});
// ... `tracked` ...
ProtocolScores evaluate_tracked(const HeadAvatar& avatar, const Capture& capture,
                                const std::vector<int>& frames,
                                const std::vector<ImageDistance>& distances = {});
// ... and `refined`: as evaluate_tracked after `steps` Adam steps on pose and expression of each
// frame (L1 + DSSIM).
ProtocolScores evaluate_refined(const HeadAvatar& avatar, const Capture& capture,
                                const std::vector<int>& frames, int steps = 20,
                                const std::vector<ImageDistance>& distances = {});

}  // namespace effigy
