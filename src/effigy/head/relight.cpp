#include "effigy/head/relight.h"

#include <algorithm>

#include "effigy/base/progress.h"
#include "effigy/head/evaluate.h"
#include "effigy/image/files.h"
#include "effigy/image/metrics.h"

namespace effigy {
namespace {

PrefilteredEnvironment scaled(PrefilteredEnvironment light, double scale) {
  for (float& v : light.diffuse.texels) v *= static_cast<float>(scale);
  for (Cubemap& level : light.specular)
    for (float& v : level.texels) v *= static_cast<float>(scale);
  return light;
}

Image rounded(const Planes& planes) {
  return to_float(to_8bit(to_image(planes)));
}

Image truth_of(const Capture& capture, const Path& path) {
  Image image = to_float(read_image8(capture.folder / path));
  if (image.channels != 3 || image.width != capture.camera.width ||
      image.height != capture.camera.height)
    throw Error((capture.folder / path).string() + ": not an RGB image of the capture's size.");
  return image;
}

// Over all frames of the set.
double best_scale(HeadRenderer& renderer, const HeadAvatar& avatar, const Capture& capture,
                  const RelightSet& set) {
  ScaleFit fit;
  for (const auto& [frame, path] : set.images) {
    renderer.set_pose(tracked_pose(avatar, capture, frame));
    fit.add(to_image(renderer.draw(capture.camera)), truth_of(capture, path));
  }
  return fit.scale();
}

struct MeanScore {
  double psnr = 0, ssim = 0;
};

MeanScore mean_score(HeadRenderer& renderer, const HeadAvatar& avatar, const Capture& capture,
                     const RelightSet& set) {
  MeanScore mean;
  const double share = 1.0 / static_cast<double>(std::max<size_t>(1, set.images.size()));
  for (const auto& [frame, path] : set.images) {
    throw_if_interrupted();
    renderer.set_pose(tracked_pose(avatar, capture, frame));
    const Image rendered = rounded(renderer.draw(capture.camera));
    const Image truth = truth_of(capture, path);
    mean.psnr += share * psnr(truth, rendered);
    mean.ssim += share * ssim(truth, rendered);
  }
  return mean;
}

}  // namespace

Path file_inside(const Json& json, const std::string& field, const Path& file) {
  Path path = json_field<std::string>(json, field, file);
  for (const Path& part : path)
    if (part == ".." || path.is_absolute())
      throw Error(file.string() + ": field '" + field +
                  "' names a file outside the capture; correct it.");
  return path;
}

std::vector<RelightSet> relight_sets(const Capture& capture) {
  std::vector<RelightSet> sets;
  if (!capture.extra.is_object() || !capture.extra.contains("relight")) return sets;
  const Path file = capture.folder / "capture.json";
  std::map<int64_t, int> by_number;
  for (size_t f = 0; f < capture.frames.size(); ++f)
    by_number[capture.frames[f].number] = static_cast<int>(f);
  for (const auto& [name, entry] : capture.extra["relight"].items()) {
    RelightSet set;
    set.name = name;
    set.light = file_inside(entry, "light", file);
    const Json images = json_field<Json>(entry, "images", file);
    for (const auto& [number, image] : images.items()) {
      const auto found = by_number.find(std::strtoll(number.c_str(), nullptr, 10));
      if (found == by_number.end())
        throw Error(file.string() + ": field 'relight' names frame " + number +
                    ", which the capture does not have; correct it.");
      set.images[found->second] = file_inside(images, number, file);
    }
    sets.push_back(std::move(set));
  }
  return sets;
}

RelightScores score_relight(const HeadAvatar& avatar, const Capture& capture,
                            const RelightSet& set) {
  RelightScores scores;
  HeadRenderer renderer(avatar);
  const PrefilteredEnvironment own = Prefilter(avatar.environment.size).forward(avatar.environment);
  const PrefilteredEnvironment light =
      prefilter_environment(read_environment(capture.folder / set.light));
  renderer.set_light(light);
  const MeanScore as_is = mean_score(renderer, avatar, capture, set);
  scores.psnr = as_is.psnr;
  scores.ssim = as_is.ssim;
  scores.scale = best_scale(renderer, avatar, capture, set);
  renderer.set_light(scaled(light, scores.scale));
  const MeanScore aligned = mean_score(renderer, avatar, capture, set);
  scores.psnr_aligned = aligned.psnr;
  scores.ssim_aligned = aligned.ssim;
  renderer.set_light(own);
  renderer.set_light(scaled(own, best_scale(renderer, avatar, capture, set)));
  scores.psnr_unlit = mean_score(renderer, avatar, capture, set).psnr;
  return scores;
}

}  // namespace effigy
