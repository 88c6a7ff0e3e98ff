#include "effigy/cli/training_distance.h"

#include <memory>

#include "effigy/cli/perceptual_files.h"
#include "effigy/infer/perceptual.h"

namespace effigy {

PictureDistance training_distance(const std::string& network, const std::string& models) {
  if (training_network(network, models) == "none") return {};
  PerceptualOptions options;
  options.models = models;
  options.lpips = network == "squeezenet10" ? "none" : network;
  const PerceptualFiles files = find_perceptual(options);
  const auto distance = std::make_shared<const PerceptualDistance>(
      network == "squeezenet10"
          ? PerceptualDistance::squeezenet10(files.squeezenet10)
          : PerceptualDistance::lpips(files.net, files.backbone, files.heads));
  return [distance](const Planes& drawn, const Planes& target, float weight, Planes& d_drawn) {
    return distance->loss(drawn, target, weight, d_drawn);
  };
}

}  // namespace effigy
