// Finding the user's files for perceptual distances (docs/evaluation.md). Needs no libtorch.
#pragma once

#include <string>
#include <vector>

#include "effigy/base/file.h"

namespace effigy {

struct PerceptualOptions {
  std::string models;           // folder; empty: $EFFIGY_DATA/perceptual
  std::string lpips = "auto";   // alex, vgg, squeeze, none, or auto: the first that has its files
  std::string backbone, heads;  // files instead of those of the folder
};

struct PerceptualFiles {
  std::string net;       // of LPIPS: "alex", "vgg", "squeeze"; empty: left out
  Path backbone, heads;  // of that net
  Path squeezenet10;     // empty: left out
  std::string note;      // why LPIPS is left out; empty when it is not

  bool any() const { return !net.empty() || !squeezenet10.empty(); }
};

// Looks in the --models folder (only there, and in its subfolder perceptual), else in
// $EFFIGY_DATA/perceptual. Files are known by their published names: <net>.pth for heads,
// alexnet-*.pth, vgg16-*.pth, squeezenet1_1-*.pth for backbones,
// squeezenet_v1.0_deep_compression.net or compressed_SqueezeNet.net. auto prefers vgg, then alex,
// then squeeze. Throws Error when a net was asked for by name and a file of it is missing.
PerceptualFiles find_perceptual(const PerceptualOptions& options);

}  // namespace effigy
