#include "effigy/track/photo.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/random.h"
#include "effigy/image/colour.h"
#include "effigy/image/resample.h"

namespace effigy {
namespace {

constexpr int kPhotoSide = 192, kForehead = 10, kChin = 152;
constexpr double kWindow = 2.3;         // sides of the window in heights of the face
constexpr double kGain = 400;           // of the stored contrast
constexpr double kSharp = 1.0;          // sigma in window pixels of what is looked at
constexpr int kCoarse = 4;              // the local mean is taken at a fourth of the size
constexpr double kCoarseSigma = 2.0;    // there
constexpr double kNearLandmark = 0.09;  // metres: ears and front of the scalp included

}  // namespace

Image grey_part(const Image8& picture, double x, double y, double width, double height,
                int out_width, int out_height) {
  const Image8 part = crop_resize(picture, x, y, width, height, out_width, out_height);
  Image grey(out_width, out_height, 1);
  for (size_t i = 0; i < grey.data.size(); ++i)
    grey.data[i] =
        luminance(part.data[3 * i], part.data[3 * i + 1], part.data[3 * i + 2]) * (1.0f / 255.0f);
  return grey;
}

PhotoWindow photo_window(const Image8& picture, const FaceObservation& face) {
  PhotoWindow window;
  if (!face.found) return window;
  const auto& p = face.landmarks;
  const double tall =
      std::hypot(p[3 * kChin] - p[3 * kForehead], p[3 * kChin + 1] - p[3 * kForehead + 1]);
  if (!(tall > 16)) return window;
  const double side = kWindow * tall;
  window.left = 0.5 * (p[3 * kChin] + p[3 * kForehead]) - 0.5 * side;
  window.top = 0.5 * (p[3 * kChin + 1] + p[3 * kForehead + 1]) - 0.5 * side;
  window.scale = kPhotoSide / side;
  const Image grey =
      grey_part(picture, window.left, window.top, side, side, kPhotoSide, kPhotoSide);
  const Image mean =
      resize(gaussian_blur(resize(grey, kPhotoSide / kCoarse, kPhotoSide / kCoarse), kCoarseSigma),
             kPhotoSide, kPhotoSide);
  const Image sharp = gaussian_blur(grey, kSharp);
  window.contrast = Image8(kPhotoSide, kPhotoSide, 1);
  for (size_t i = 0; i < grey.data.size(); ++i)
    window.contrast.data[i] = static_cast<uint8_t>(
        std::clamp(128.5 + kGain * static_cast<double>(sharp.data[i] - mean.data[i]), 0.0, 255.0));
  return window;
}

bool PhotoWindow::sample(const Vec2d& pixel, double* value, Vec2d* derivative) const {
  const double x = (pixel.x() - left) * scale - 0.5, y = (pixel.y() - top) * scale - 0.5;
  if (!(x >= 2 && y >= 2 && x < contrast.width - 3 && y < contrast.height - 3)) return false;
  const int ix = static_cast<int>(x), iy = static_cast<int>(y);
  const double a = x - ix, b = y - iy;
  const uint8_t* row = contrast.at(ix, iy);
  const auto at = [&](int dx, int dy) {
    return static_cast<double>(row[dy * contrast.width + dx]);
  };
  // Bilinear between the four pixels' values and their central differences.
  const auto between = [&](auto&& v) {
    return (1 - b) * ((1 - a) * v(0, 0) + a * v(1, 0)) + b * ((1 - a) * v(0, 1) + a * v(1, 1));
  };
  *value = (between(at) - 128) / kGain;
  derivative->x() =
      between([&](int u, int v) { return 0.5 * (at(u + 1, v) - at(u - 1, v)); }) * scale / kGain;
  derivative->y() =
      between([&](int u, int v) { return 0.5 * (at(u, v + 1) - at(u, v - 1)); }) * scale / kGain;
  return true;
}

LandmarkEmbedding choose_photo_points(const Rig& rig, const std::vector<float>& rest, int count) {
  const auto vertex = [&](int v) { return Vec3f(&rest[3 * static_cast<size_t>(v)]); };
  const std::vector<float> landmarks = landmark_positions(rig.mediapipe, rig.mesh.triangles, rest);
  std::vector<int> candidates;
  std::vector<double> until;  // running sum of areas
  double area = 0;
  for (int t = 0; t < rig.mesh.triangle_count(); ++t) {
    if (!rig.mesh.triangle_part.empty() && rig.mesh.parts[rig.mesh.triangle_part[t]] != "skin")
      continue;
    const Vec3i triangle = rig.mesh.triangles[t];
    const Vec3f a = vertex(triangle[0]), b = vertex(triangle[1]), c = vertex(triangle[2]);
    const Vec3f middle = (a + b + c) / 3;
    bool near = false;
    for (size_t l = 0; l < landmarks.size() && !near; l += 3)
      near = (middle - Vec3f(&landmarks[l])).norm() < static_cast<float>(kNearLandmark);
    if (!near) continue;
    area += 0.5 * static_cast<double>((b - a).cross(c - a).norm());
    candidates.push_back(t);
    until.push_back(area);
  }
  LandmarkEmbedding points;
  Random random(7);
  for (int i = 0; i < count && !candidates.empty(); ++i) {
    const double at = area * (i + random.uniform(0.0, 1.0)) / count;
    const auto found = std::lower_bound(until.begin(), until.end(), at) - until.begin();
    double u = random.uniform(0.0, 1.0), v = random.uniform(0.0, 1.0);
    if (u + v > 1) {
      u = 1 - u;
      v = 1 - v;
    }
    points.index.push_back(i);
    points.triangle.push_back(candidates[std::min<size_t>(found, candidates.size() - 1)]);
    points.barycentric.emplace_back(static_cast<float>(1 - u - v), static_cast<float>(u),
                                    static_cast<float>(v));
  }
  return points;
}

}  // namespace effigy
