// Scores an avatar against a capture's held-out frames, under named protocols:
//   tracker  rig parameters from tracking alone, nothing fitted to the test image
//   refined  pose and expression refined against the test image with the avatar frozen
#pragma once

#include <string>
#include <vector>

#include "effigy/avatar/renderer.h"
#include "effigy/capture/capture.h"
#include "effigy/head/frames.h"

namespace effigy {

struct FrameScore {
  int frame = 0;  // index into capture.frames
  double psnr = 0, psnr_foreground = 0, ssim = 0, coverage = 0, flip = 0;
};

struct ProtocolScores {
  std::vector<FrameScore> frames;
  std::vector<RigPose> poses;  // used for each frame
  FrameScore mean() const;
  Json to_json() const;  // design names: frames psnr psnr_foreground ssim coverage flip lpips ...
};

// Both images as 8-bit values on black. `neck_row`: pixel row of the neck line (image height:
// none).
FrameScore score_frame(const Planes& colour, const Planes& gbuffer, const TargetFrame& target,
                       double neck_row);
// Lowest image row that still counts as head: the highest point of the projected neck ring.
double neck_row(const HeadAvatar& avatar, const std::vector<float>& vertices, const Camera& camera);

// Poses of the given frames under the protocol `tracker`.
ProtocolScores evaluate_tracker(const HeadAvatar& avatar, const Capture& capture,
                                const std::vector<int>& frames);
// As evaluate_tracker after `steps` Adam steps on pose and expression of each frame (L1 + DSSIM).
ProtocolScores evaluate_refined(const HeadAvatar& avatar, const Capture& capture,
                                const std::vector<int>& frames, int steps = 20);

}  // namespace effigy
