// A capture small enough for tests: a two-joint rig shaped like a bumpy ball, drawn as flat discs.
#pragma once

#include <cmath>
#include <numbers>

#include "effigy/capture/capture.h"
#include "effigy/image/files.h"

namespace effigy::test {

// A UV sphere of radius 0.1 m with one expression (the lower half widens) and one identity mode.
inline Rig ball_rig(int rings = 10, int segments = 16) {
  Rig rig;
  rig.kind = "builtin";
  rig.licence = "Apache-2.0";
  Mesh& mesh = rig.mesh;
  mesh.parts = {"skin"};
  for (int r = 0; r <= rings; ++r)
    for (int s = 0; s <= segments; ++s) {
      const double theta = std::numbers::pi * r / rings;
      const double phi = 2 * std::numbers::pi * s / segments;
      mesh.uvs.emplace_back(0.02f + 0.96f * static_cast<float>(s) / segments,
                            0.98f - 0.96f * static_cast<float>(r) / rings);
      if (s == segments) continue;
      mesh.vertices.push_back(static_cast<float>(0.1 * std::sin(theta) * std::sin(phi)));
      mesh.vertices.push_back(static_cast<float>(0.1 * std::cos(theta)));
      mesh.vertices.push_back(static_cast<float>(0.1 * std::sin(theta) * std::cos(phi)));
    }
  const auto vertex = [&](int r, int s) { return r * segments + s % segments; };
  const auto uv = [&](int r, int s) { return r * (segments + 1) + s; };
  for (int r = 0; r < rings; ++r)
    for (int s = 0; s < segments; ++s) {
      if (r > 0) {
        mesh.triangles.emplace_back(vertex(r, s), vertex(r + 1, s), vertex(r, s + 1));
        mesh.uv_triangles.emplace_back(uv(r, s), uv(r + 1, s), uv(r, s + 1));
      }
      if (r + 1 < rings) {
        mesh.triangles.emplace_back(vertex(r, s + 1), vertex(r + 1, s), vertex(r + 1, s + 1));
        mesh.uv_triangles.emplace_back(uv(r, s + 1), uv(r + 1, s), uv(r + 1, s + 1));
      }
    }
  mesh.triangle_part.assign(mesh.triangles.size(), 0);
  const int vertices = mesh.vertex_count();
  rig.identity_count = rig.expression_count = 1;
  rig.identity_basis.assign(3 * static_cast<size_t>(vertices), 0.0f);
  rig.expression_basis = rig.identity_basis;
  for (int v = 0; v < vertices; ++v) {
    rig.identity_basis[3 * v + 1] = 0.1f * mesh.vertices[3 * v + 1];
    if (mesh.vertices[3 * v + 1] < 0) rig.expression_basis[3 * v] = 0.3f * mesh.vertices[3 * v];
  }
  rig.expression_names = {"widen"};
  rig.identity_sigma = {1.0f};
  rig.expression_low = {0.0f};
  rig.expression_high = {1.0f};
  rig.joint_names = {"root", "neck"};
  rig.parents = {-1, 0};
  rig.joint_regressor.assign(2 * static_cast<size_t>(vertices),
                             1.0f / static_cast<float>(vertices));
  for (int v = 0; v < vertices; ++v) {
    rig.weights.push_back(0.0f);
    rig.weights.push_back(1.0f);
  }
  rig.mediapipe.index = {0};
  rig.mediapipe.triangle = {static_cast<int>(mesh.triangles.size()) / 2};
  rig.mediapipe.barycentric = {Vec3f(0.4f, 0.3f, 0.3f)};
  return rig;
}

inline Camera small_camera(int size) {
  Camera camera;
  camera.width = camera.height = size;
  camera.fx = camera.fy = 2.8 * size;
  camera.cx = camera.cy = 0.5 * size;
  camera.camera_from_world_rotation = Vec3d(1, -1, -1).asDiagonal();
  return camera;
}

// Writes a capture of `count` frames in which a shaded disc stands for the ball.
inline void write_tiny_capture(const Path& folder, int count = 8, int size = 64) {
  Capture capture;
  capture.source = "test";
  capture.rig = ball_rig();
  capture.identity = {0.0f};
  capture.camera = small_camera(size);
  for (int f = 0; f < count; ++f) {
    CaptureFrame frame;
    frame.number = f;
    frame.image = "images/cam0/" + std::to_string(f) + ".png";
    frame.mask = "masks/cam0/" + std::to_string(f) + ".png";
    Image8 image(size, size, 3, 30), mask(size, size, 1);
    for (int y = 0; y < size; ++y)
      for (int x = 0; x < size; ++x) {
        const double u = (x + 0.5 - 0.5 * size) / (0.28 * size),
                     v = (y + 0.5 - 0.5 * size) / (0.28 * size);
        if (u * u + v * v > 1) continue;
        mask.at(x, y)[0] = 255;
        image.at(x, y)[0] = static_cast<uint8_t>(150 + 60 * std::sin(5 * u));
        image.at(x, y)[1] = static_cast<uint8_t>(120 + 50 * std::cos(6 * v));
        image.at(x, y)[2] = 90;
      }
    write_png8(folder / frame.image, image);
    write_png8(folder / frame.mask, mask);
    capture.frames.push_back(frame);
    RigPose pose = RigPose::rest(capture.rig);
    pose.translation = {0, 0, -1.0f};
    pose.joint_rotation[1] = 0.02f * static_cast<float>(f);
    capture.poses.push_back(pose);
  }
  split_test_frames(capture);
  write_capture(capture, folder);
}

}  // namespace effigy::test
