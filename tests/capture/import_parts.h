// What the tests of importers write alike: a ball under lamps, as sources show it.
#pragma once

#include <cmath>

#include "effigy/base/json.h"
#include "effigy/base/log.h"
#include "effigy/capture/import_stage.h"
#include "effigy/capture/stage_capture.h"
#include "support.h"
#include "tiny_capture.h"
#include "write_avif.h"
#include "write_zip.h"

namespace effigy::test {

inline std::vector<uint8_t> bytes_of(const std::string& text) {
  return {text.begin(), text.end()};
}

// The ball of tiny_capture.h with vertices scaled and moved, as an OBJ file.
inline Mesh ball_mesh(double scale, const Vec3d& by = Vec3d::Zero()) {
  Mesh mesh = ball_rig().mesh;
  for (int v = 0; v < mesh.vertex_count(); ++v)
    for (int c = 0; c < 3; ++c)
      mesh.vertices[3 * static_cast<size_t>(v) + static_cast<size_t>(c)] =
          static_cast<float>(scale * (static_cast<double>(mesh.vertex(v)[c]) + by[c]));
  return mesh;
}

inline std::vector<uint8_t> ply_bytes(const std::vector<float>& vertices) {
  std::string text = "ply\nformat ascii 1.0\nelement vertex " +
                     std::to_string(vertices.size() / 3) +
                     "\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
  for (size_t i = 0; i < vertices.size(); ++i)
    text += std::to_string(vertices[i]) + (i % 3 == 2 ? "\n" : " ");
  return bytes_of(text);
}

inline Image8 plain(int width, int height, int red, int green, int blue) {
  Image8 image(width, height, 3);
  for (size_t i = 0; i < image.data.size(); i += 3) {
    image.data[i] = static_cast<uint8_t>(red);
    image.data[i + 1] = static_cast<uint8_t>(green);
    image.data[i + 2] = static_cast<uint8_t>(blue);
  }
  return image;
}

// Value `inside` in the left half.
inline Image8 left_half(int width, int height, uint8_t inside) {
  Image8 mask(width, height, 1);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width / 2; ++x) mask.at(x, y)[0] = inside;
  return mask;
}

// A camera on a circle about the y axis, looking at the middle.
inline Camera circle_camera(int number, int width, int height) {
  const double angle = 0.7 * number;
  return look_at(Vec3d(2 * std::sin(angle), 0.3, 2 * std::cos(angle)), Vec3d::Zero(), 0.4, width,
                 height);
}

}  // namespace effigy::test
