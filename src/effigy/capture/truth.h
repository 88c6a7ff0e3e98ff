// What a synthetic capture knows beside its images (docs/formats.md): posed vertices, rig
// parameters, keypoints, irradiance, and image layers.
#pragma once

#include <map>
#include <optional>

#include "effigy/capture/capture.h"

namespace effigy {

struct CaptureTruth {
  std::string transport;               // "split-sum", "unshadowed" or "path-traced"
  std::vector<std::string> parts;      // of label k in layer "part": parts[k - 1]; 0: nothing
  std::map<std::string, Path> layers;  // name -> folder of files named as the frames' images
  std::vector<float> identity;
  std::vector<RigPose> poses;     // one per frame; capture.poses holds what a tracker made of them
  std::vector<float> vertices;    // [frames][V][3], metres, world
  std::vector<float> irradiance;  // [frames][V][3], share of the light that arrives; may be empty
  std::vector<float> keypoints;   // [frames][68][3], MultiPIE order, world
};

// Writes truth.safetensors and adds what points to it to capture.extra.
void write_truth(const CaptureTruth& truth, Capture& capture, const Path& folder);
// Empty for captures without. Throws Error naming file and field.
std::optional<CaptureTruth> read_truth(const Capture& capture);
// One layer of one frame (index into capture.frames): "radiance" 4 channels (linear, times alpha,
// alpha), "albedo" 3 (linear), "material" 3 (roughness, F0, visibility), "normal" 3 (world, with
// the normal map), "depth" 1 (camera z, metres), "uv" 2, "part" 1 (label). 0 where nothing is.
// Throws Error naming the file when it is absent, of another size, or not finite.
Image load_layer(const Capture& capture, const CaptureTruth& truth, const std::string& layer,
                 int frame);

}  // namespace effigy
