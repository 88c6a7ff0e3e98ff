// effigy eval and study in effigy-learn: with the networks of perceptual distances.

#include <memory>

#include "effigy/cli/commands.h"
#include "effigy/cli/eval.h"
#include "effigy/cli/family.h"
#include "effigy/infer/perceptual.h"

namespace effigy {
namespace {

PerceptualDistances distances_of(const PerceptualFiles& files) {
  PerceptualDistances result;
  result.lpips_net = files.net;
  result.lpips_note = files.note;
  if (!files.net.empty()) {
    const auto lpips = std::make_shared<PerceptualDistance>(
        PerceptualDistance::lpips(files.net, files.backbone, files.heads));
    result.distances.push_back(
        {"lpips", [lpips](const Image& a, const Image& b) { return lpips->between(a, b); }});
    result.distances.push_back({"lpips_unit_range", [lpips](const Image& a, const Image& b) {
                                  return lpips->between_unit_range(a, b);
                                }});
  }
  if (!files.squeezenet10.empty()) {
    const auto features =
        std::make_shared<PerceptualDistance>(PerceptualDistance::squeezenet10(files.squeezenet10));
    result.distances.push_back({"feature_squeezenet10", [features](const Image& a, const Image& b) {
                                  return features->between(a, b);
                                }});
  }
  return result;
}

}  // namespace

int run_eval_learn(int argc, char** argv) {
  if (names_avatar(argc, argv, "body")) return evaluate_body_command(argc, argv, distances_of);
  return evaluate_command(argc, argv, distances_of);
}

int run_study_learn(int argc, char** argv) {
  return run_study_body(argc, argv, distances_of(find_perceptual({})));
}

}  // namespace effigy
