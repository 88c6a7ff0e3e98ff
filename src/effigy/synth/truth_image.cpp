#include "effigy/synth/truth_image.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "effigy/base/error.h"
#include "effigy/base/random.h"
#include "effigy/image/colour.h"
#include "effigy/image/files.h"
#include "effigy/image/resample.h"
#include "effigy/light/builtin_lights.h"
#include "effigy/shade/deferred.h"

namespace effigy {
namespace {

constexpr int kWidestLight = 1024;

bool is_builtin(const std::string& name) {
  const auto names = builtin_light_names();
  return std::find(names.begin(), names.end(), name) != names.end();
}

double mean_luminance(const Image& light) {
  double sum = 0, weights = 0;
  for (int y = 0; y < light.height; ++y) {
    const double weight = std::sin(std::numbers::pi * (y + 0.5) / light.height);
    for (int x = 0; x < light.width; ++x) {
      const float* p = light.at(x, y);
      sum += weight * luminance(p[0], p[1], p[2]);
      weights += weight;
    }
  }
  return sum / weights;
}

}  // namespace

Image split_sum_image(const TraceScene& scene, const Camera& camera,
                      const PrefilteredEnvironment& light, int across) {
  const Camera large = camera.resized(camera.width * across, camera.height * across);
  const Planes gbuffer = trace_gbuffer(scene, large);
  Planes colour, radiance;
  shade_deferred(gbuffer, large, light, {}, colour, &radiance);
  Image samples(large.width, large.height, 4);
  for (size_t i = 0; i < gbuffer.pixels(); ++i) {
    for (int c = 0; c < 3; ++c) samples.data[4 * i + c] = radiance.plane(c)[i];
    samples.data[4 * i + 3] = gbuffer.plane(kAlpha)[i];
  }
  return resize(samples, camera.width, camera.height);
}

Image display_image(const Image& radiance) {
  EFFIGY_CHECK_EQ(radiance.channels, 4);
  Image image(radiance.width, radiance.height, 3);
  for (size_t i = 0; i < radiance.data.size() / 4; ++i) {
    const float alpha = radiance.data[4 * i + 3];
    if (alpha <= 0) continue;
    for (size_t c = 0; c < 3; ++c)
      image.data[3 * i + c] =
          alpha * srgb_from_linear(std::min(radiance.data[4 * i + c] / alpha, 1.0f));
  }
  return image;
}

Image planes_image(const Planes& planes, int first, int count) {
  Image image(planes.width, planes.height, count);
  for (size_t i = 0; i < planes.pixels(); ++i)
    for (int c = 0; c < count; ++c)
      image.data[i * static_cast<size_t>(count) + c] = planes.plane(first + c)[i];
  return image;
}

Image alpha_image(const Image& radiance) {
  Image alpha(radiance.width, radiance.height, 1);
  for (size_t i = 0; i < alpha.data.size(); ++i) alpha.data[i] = radiance.data[4 * i + 3];
  return alpha;
}

Image synth_light(const std::string& name_or_file) {
  if (is_builtin(name_or_file)) return builtin_light(name_or_file);
  if (!std::filesystem::exists(name_or_file)) {
    std::string names;
    for (const std::string& name : builtin_light_names()) names += ", " + name;
    throw Error("There is no light " + name_or_file + ": neither a built-in one (" +
                names.substr(2) + ") nor a file; check the name.");
  }
  Image light = read_environment(name_or_file);
  if (light.width > kWidestLight) light = resize(light, kWidestLight, kWidestLight / 2);
  const double mean = mean_luminance(light);
  for (float& value : light.data) value = static_cast<float>(value / mean);
  return light;
}

std::string synth_light_name(const std::string& name_or_file) {
  if (is_builtin(name_or_file)) return name_or_file;
  std::string name = Path(name_or_file).stem().string();
  for (char& c : name)
    if (!std::isalnum(static_cast<unsigned char>(c)) && c != '-' && c != '_') c = '_';
  return name.empty() ? "light" : name;
}

void add_noise(Image& image, const Image& radiance, double deviation, uint64_t seed,
               uint64_t frame) {
  Random random(seed ^ 0x6e6f697365ULL, frame);
  for (size_t i = 0; i < image.data.size(); ++i)
    image.data[i] +=
        static_cast<float>(deviation * random.normal()) * radiance.data[4 * (i / 3) + 3];
}

Image8 compress(const Image8& image, int quality) {
  return decode_image8(encode_jpeg(image, quality), "a compressed frame");
}

}  // namespace effigy
