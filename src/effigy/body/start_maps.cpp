#include "effigy/body/start_maps.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/threads.h"
#include "effigy/image/colour.h"
#include "effigy/shade/transfer.h"

namespace effigy {
namespace {

constexpr size_t kFrames = 6, kCameras = 8;
constexpr float kLeastFacing = 0.3f;   // cosine between normal and view
constexpr float kNearSurface = 0.01f;  // metres by which rays may miss a texel
constexpr uint8_t kInside = 230;       // of the mask

template <typename T>
std::vector<T> spread(const std::vector<T>& all, size_t most) {
  std::vector<T> picked;
  const size_t count = std::min(all.size(), most);
  for (size_t i = 0; i < count; ++i) picked.push_back(all[i * all.size() / count]);
  return picked;
}

struct Fit {
  std::vector<double> product, square;  // 3 a texel: sums of image * shade and shade^2
};

// What the model shows of an albedo of 1: 3 planes.
std::vector<float> shade_of(const BodyModel& model, const BodyLight& light) {
  const BodySurface& surface = model.surface();
  const size_t n = surface.count();
  std::vector<float> position(3 * n), shade(3 * n);
  for (size_t i = 0; i < n; ++i)
    for (size_t c = 0; c < 3; ++c) position[c * n + i] = surface.placed.center[3 * i + c];
  // Every appearance starts as Lambert about the normal.
  std::vector<float> lambert(kZonalCoefficients * n);
  for (size_t l = 0; l < kZonalBands; ++l)
    for (size_t c = 0; c < (l < kZonalColourBands ? 3u : 1u); ++c)
      std::fill_n(&lambert[zonal_index(2, l, c) * n], n, static_cast<float>(lambert_zonal()[l]));
  std::vector<float> given(3 * n);
  for (size_t g = 0; g < light.parts().size(); ++g) {
    const BodyLight& part = light.parts()[g];
    shade_diffuse({part.points, part.sh, part.bands.get()},
                  {n, surface.placed.axes, position, lambert}, given);
    for (size_t c = 0; c < 3; ++c)
      for (size_t i = 0; i < n; ++i)
        shade[c * n + i] +=
            given[c * n + i] * (surface.shadow.empty() ? 1.0f : surface.shadow[g * n + i]);
  }
  return shade;
}

void add_view(const StageCapture& capture, int camera, int frame, const BodyModel& model,
              const RayScene& rays, const std::vector<float>& shade, Fit& fit) {
  const Image8 image = capture.load_image(camera, frame), mask = capture.load_mask(camera, frame);
  const Camera& view = capture.cameras[static_cast<size_t>(camera)].camera;
  const std::array<float, 256> linear = linear_table(capture.display);
  const BodySurface& surface = model.surface();
  const size_t n = surface.count();
  const Vec3f eye = view.center().cast<float>();
  parallel_for(n, 256, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i) {
      const Vec3f at(&surface.placed.center[3 * i]);
      const Vec3f normal(surface.placed.normal[i], surface.placed.normal[n + i],
                         surface.placed.normal[2 * n + i]);
      const Vec3f to = eye - at;
      const float distance = to.norm(), facing = normal.dot(to) / distance;
      if (!(facing > kLeastFacing) || view.to_camera(at.cast<double>()).z() <= 0) continue;
      const Vec2d pixel = view.project(at.cast<double>());
      const int x = static_cast<int>(std::floor(pixel.x()));
      const int y = static_cast<int>(std::floor(pixel.y()));
      if (x < 0 || y < 0 || x >= image.width || y >= image.height || *mask.at(x, y) < kInside)
        continue;
      if (rays.closest(eye, -to / distance).distance < distance - kNearSurface) continue;
      for (size_t c = 0; c < 3; ++c) {
        const auto s = static_cast<double>(shade[c * n + i]);
        const double weighted = s * static_cast<double>(facing);
        fit.product[3 * i + c] += weighted * static_cast<double>(linear[image.at(x, y)[c]]);
        fit.square[3 * i + c] += weighted * s;
      }
    }
  });
}

}  // namespace

void start_albedo(StageMoments& moments, BodyModel& model) {
  const StageCapture& capture = moments.source().capture();
  std::vector<int> frames;
  for (const int f : capture.frames_of(StageSplit::kTrain))
    if (capture.frames[static_cast<size_t>(f)].fully_lit) frames.push_back(f);
  if (frames.empty()) frames = capture.frames_of(StageSplit::kTrain);
  const size_t n = model.texels().count();
  Fit fit{std::vector<double>(3 * n), std::vector<double>(3 * n)};
  // A sample too small to judge the capture by: whether too much is missing, training finds out.
  constexpr size_t kAnyNumber = 10 * kFrames * kCameras;
  LeftOutViews left_out;
  for (const int frame : spread(frames, kFrames)) {
    try {
      const StageMoment at = moments.source().moment(frame);
      model.pose(moments.moment(at));
      model.light(moments.irradiance(at, at));
      const std::vector<float> shade = shade_of(model, *moments.light(at));
      const RayScene& rays = moments.rays(at);
      for (const int camera : spread(capture.cameras_of(frame, capture.train_cameras()), kCameras))
        try {
          add_view(capture, camera, frame, model, rays, shade, fit);
        } catch (const Error& error) {
          left_out.add(error, kAnyNumber);
        }
    } catch (const Error& error) {
      left_out.add(error, kAnyNumber);
    }
  }
  std::vector<float>& albedo = model.maps().albedo;
  for (size_t c = 0; c < 3; ++c) {
    std::vector<float> seen;
    for (size_t i = c; i < 3 * n; i += 3)
      if (fit.square[i] > 0) {
        albedo[i] = std::clamp(static_cast<float>(fit.product[i] / fit.square[i]), 0.02f, 0.98f);
        seen.push_back(albedo[i]);
      }
    if (seen.empty()) continue;
    const auto middle = seen.begin() + static_cast<std::ptrdiff_t>(seen.size() / 2);
    std::nth_element(seen.begin(), middle, seen.end());
    for (size_t i = c; i < 3 * n; i += 3)
      if (fit.square[i] <= 0) albedo[i] = *middle;
  }
}

}  // namespace effigy
