#include "effigy/cli/perceptual_files.h"

#include <algorithm>
#include <cstdlib>

#include "effigy/base/error.h"

namespace effigy {
namespace {

struct Net {
  const char* name;
  const char* heads;
  const char* backbone;  // how its file's name begins
};
// In order of preference: VGG is what papers on avatars report.
constexpr Net kNets[] = {{"vgg", "vgg.pth", "vgg16-"},
                         {"alex", "alex.pth", "alexnet-"},
                         {"squeeze", "squeeze.pth", "squeezenet1_1-"}};

std::vector<Path> folders(const std::string& models) {
  if (!models.empty()) {
    if (!std::filesystem::is_directory(models))
      throw Error("--models " + models +
                  ": there is no such folder; name the one that holds the perceptual weights.");
    return {models, Path(models) / "perceptual"};
  }
  const char* data = std::getenv("EFFIGY_DATA");
  if (data == nullptr || *data == '\0') return {};
  return {Path(data) / "perceptual"};
}

Path file_named(const std::vector<Path>& places, const std::string& name) {
  std::error_code problem;
  for (const Path& place : places)
    if (std::filesystem::exists(place / name, problem)) return place / name;
  return {};
}

// The first file, in the order of the alphabet, begin*.pth; empty: none.
Path file_like(const std::vector<Path>& places, const std::string& begin) {
  std::vector<Path> found;
  for (const Path& place : places) {
    std::error_code problem;
    for (const auto& entry : std::filesystem::directory_iterator(place, problem)) {
      const std::string name = entry.path().filename().string();
      if (name.starts_with(begin) && name.ends_with(".pth")) found.push_back(entry.path());
    }
    if (!found.empty()) return *std::min_element(found.begin(), found.end());
  }
  return {};
}

std::string missing(const Net& net, const PerceptualFiles& files) {
  const std::string backbone = std::string(net.backbone) + "*.pth";
  if (files.backbone.empty() && files.heads.empty())
    return "the backbone " + backbone + " and the heads " + net.heads;
  return files.backbone.empty() ? "the backbone " + backbone
                                : "the heads " + std::string(net.heads);
}

// Fills in the net's files; false when one is missing.
bool find_net(const Net& net, const std::vector<Path>& places, const PerceptualOptions& options,
              PerceptualFiles& files) {
  files.backbone =
      options.backbone.empty() ? file_like(places, net.backbone) : Path(options.backbone);
  files.heads = options.heads.empty() ? file_named(places, net.heads) : Path(options.heads);
  return !files.backbone.empty() && !files.heads.empty();
}

void find_lpips(const std::vector<Path>& places, const PerceptualOptions& options,
                PerceptualFiles& files) {
  if (options.lpips == "none") {
    files.note = "left out: --lpips none";
    return;
  }
  for (const Net& net : kNets) {
    if (options.lpips != "auto" && options.lpips != net.name) continue;
    if (find_net(net, places, options, files)) {
      files.net = net.name;
      files.note.clear();
      return;
    }
    if (options.lpips != "auto")
      throw Error("--lpips " + options.lpips + ": " + missing(net, files) +
                  " cannot be found; put the files into the folder of --models or "
                  "$EFFIGY_DATA/perceptual (docs/evaluation.md says where they come from).");
    // The most helpful note is about a net of which one file is there.
    if (files.note.empty() && files.backbone.empty() != files.heads.empty())
      files.note = "left out: " + missing(net, files) + " is not there";
  }
  if (files.note.empty()) files.note = "left out: no backbone weights";
  files.backbone.clear();
  files.heads.clear();
}

}  // namespace

std::string training_network(const std::string& name, const std::string& models) {
  if (name == "none") return name;
  PerceptualOptions options;
  options.models = models;
  if (name == "squeezenet10") {
    if (find_perceptual(options).squeezenet10.empty())
      throw Error(
          "--perceptual squeezenet10: squeezenet_v1.0_deep_compression.net cannot be found; "
          "put it into the folder of --models or $EFFIGY_DATA/perceptual "
          "(docs/evaluation.md says where it comes from).");
    return name;
  }
  if (name != "auto" && std::none_of(std::begin(kNets), std::end(kNets),
                                     [&](const Net& net) { return name == net.name; }))
    throw Error("--perceptual must be auto, vgg, alex, squeeze, squeezenet10 or none, not '" +
                name + "'.");
  options.lpips = name;
  const PerceptualFiles files = find_perceptual(options);
  if (!files.net.empty()) return files.net;
  return files.squeezenet10.empty() ? "none" : "squeezenet10";
}

PerceptualFiles find_perceptual(const PerceptualOptions& options) {
  if (options.lpips == "auto" && (!options.backbone.empty() || !options.heads.empty()))
    throw Error("--lpips-backbone and --lpips-heads need --lpips alex, vgg or squeeze.");
  const std::vector<Path> places = folders(options.models);
  PerceptualFiles files;
  find_lpips(places, options, files);
  for (const char* name : {"squeezenet_v1.0_deep_compression.net", "compressed_SqueezeNet.net"})
    if (files.squeezenet10.empty()) files.squeezenet10 = file_named(places, name);
  return files;
}

}  // namespace effigy
