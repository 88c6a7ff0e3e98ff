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

// The network of a training's perceptual term that `name` asks for, as a value of the setting
// `perceptual` (docs/body-training.md): none, vgg, alex, squeeze or squeezenet10 as they are; auto
// becomes the LPIPS net that has its files in `models` (a folder as above), else squeezenet10, else
// none. Throws Error when a file of the network named is missing, or the name is none of these.
std::string training_network(const std::string& name, const std::string& models);

}  // namespace effigy
