// A stage capture whose pictures are known in closed form: a painted Lambertian ball that turns and
// wanders under lamps.
#pragma once

#include <cmath>
#include <optional>

#include "effigy/capture/stage_capture.h"
#include "effigy/image/colour.h"
#include "effigy/image/files.h"
#include "tiny_capture.h"

namespace effigy::test {

inline Vec3f ball_albedo(const Vec3f& local) {
  return {0.5f + 0.3f * std::sin(40 * local.x()), 0.4f + 0.2f * std::cos(30 * local.y()),
          local.z() > 0 ? 0.6f : 0.3f};
}

// What one pixel of the ball shows.
struct BallPixel {
  Vec3f normal = Vec3f::Zero(), point = Vec3f::Zero(), albedo = Vec3f::Zero();
  float depth = 0;
};
inline std::optional<BallPixel> ball_pixel(const Camera& camera, int x, int y,
                                           const Eigen::Matrix<float, 3, 4>& world) {
  const Vec3f ray =
      (camera.camera_from_world_rotation.transpose() *
       Vec3d((x + 0.5 - camera.cx) / camera.fx, (y + 0.5 - camera.cy) / camera.fy, 1.0))
          .normalized()
          .cast<float>();
  const Vec3f center = world.col(3), from = camera.center().cast<float>() - center;
  const float b = from.dot(ray), d = b * b - from.squaredNorm() + 0.01f;
  if (d < 0) return std::nullopt;
  BallPixel pixel;
  pixel.normal = (from + (-b - std::sqrt(d)) * ray) / 0.1f;
  pixel.point = center + 0.1f * pixel.normal;
  pixel.albedo = ball_albedo(0.1f * (world.leftCols<3>().transpose() * pixel.normal));
  pixel.depth = (-b - std::sqrt(d)) *
                ray.dot(camera.camera_from_world_rotation.row(2).transpose().cast<float>());
  return pixel;
}

inline void write_ball_layers(const Path& folder, const StageCamera& seen, int64_t frame,
                              const Eigen::Matrix<float, 3, 4>& world) {
  const int width = seen.camera.width, height = seen.camera.height;
  Image albedo(width, height, 3), material(width, height, 3), normal(width, height, 3),
      depth(width, height, 1), radiance(width, height, 4);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const std::optional<BallPixel> pixel = ball_pixel(seen.camera, x, y, world);
      if (!pixel) continue;
      Eigen::Map<Vec3f>(albedo.at(x, y)) = pixel->albedo;
      Eigen::Map<Vec3f>(normal.at(x, y)) = pixel->normal;
      *depth.at(x, y) = pixel->depth;
      material.at(x, y)[0] = 0.5f;
      radiance.at(x, y)[3] = 1.0f;
    }
  const auto write = [&](const char* layer, const Image& image) {
    write_exr(folder / stage_layer_path(layer, seen.name, frame), image, false);
  };
  write("albedo", albedo);
  write("material", material);
  write("normal", normal);
  write("depth", depth);
  write("radiance", radiance);
}

inline constexpr float kBallSky = 0.8f;  // radiance of the even environment

// Four cameras (the last held out), six lamps; every third frame fully lit, the last one of unseen
// motion. With `truth` that one is seen again under an even environment, and all layers are there.
inline StageCapture write_lit_ball(const Path& folder, int frames = 7, int size = 48,
                                   bool truth = false) {
  StageCapture c;
  c.folder = folder;
  c.source = "a painted ball";
  c.rig = ball_rig(16, 24);
  for (int k = 0; k < 4; ++k) {
    const double angle = 0.9 * k - 1.2;
    c.cameras.push_back({"cam" + std::to_string(k),
                         look_at(Vec3d(std::sin(angle), 0.2, std::cos(angle)) * 0.6, Vec3d::Zero(),
                                 0.55, size, size),
                         k == 3});
  }
  for (int k = 0; k < 6; ++k)
    c.lights.push_back({Vec3f(std::cos(1.1f * static_cast<float>(k)), k % 2 ? 0.6f : -0.2f,
                              std::sin(1.1f * static_cast<float>(k))) *
                            2.0f,
                        Vec3f(3.0f, 2.8f, 2.6f)});
  if (truth) {
    c.layers = {"albedo", "material", "normal", "depth", "radiance"};
    write_exr(folder / "lights/even.exr", Image(32, 16, 3, kBallSky), false);
  }
  for (int f = 0; f < frames + (truth ? 1 : 0); ++f) {
    StageFrame frame;
    frame.number = f;
    frame.fully_lit = f % 3 == 0 && f < frames;
    if (f == frames)
      frame.environment = "lights/even.exr";
    else if (!frame.fully_lit)
      frame.lights = {{f % 6, 1.5f}, {(f + 2) % 6, 1.5f}};
    if (f + 1 >= frames) frame.split = f < frames ? StageSplit::kMotion : StageSplit::kEnvironment;
    c.frames.push_back(frame);
    const int moment = std::min(f, frames - 1);
    RigPose pose = RigPose::rest(c.rig);
    pose.joint_rotation[1] = 0.15f * static_cast<float>(moment);
    pose.translation = {0.01f * static_cast<float>(moment % 3), 0, 0};
    c.poses.push_back(pose);
    const RigShape shape = shape_rig(c.rig, {});
    StageFrameArrays arrays;
    pose_vertices(shape, pose, arrays.tracked);
    write_frame_arrays(arrays, folder, f);
    const std::vector<float> joints = joint_transforms(shape, pose);
    std::array<float, 12> root{};
    std::copy_n(joints.begin(), 12, root.begin());
    c.body_from_rest.push_back(root);
    c.face_from_rest.push_back(root);
    for (const size_t vertex : {0u, 40u, 100u})
      for (size_t i = 0; i < 3; ++i) c.body_keypoints.push_back(arrays.tracked[3 * vertex + i]);
    for (size_t i = 0; i < 3; ++i) c.face_keypoints.push_back(arrays.tracked[3 * 60 + i]);
    const Eigen::Matrix<float, 3, 4> world =
        Eigen::Map<const Eigen::Matrix<float, 3, 4, Eigen::RowMajor>>(root.data());
    for (size_t k = 0; k < c.cameras.size(); ++k) {
      const Camera& camera = c.cameras[k].camera;
      Image8 image(size, size, 3), mask(size, size, 1);
      for (int y = 0; y < size; ++y)
        for (int x = 0; x < size; ++x) {
          const std::optional<BallPixel> pixel = ball_pixel(camera, x, y, world);
          if (!pixel) continue;
          Vec3f light = Vec3f::Constant(f < frames ? 0.0f : kBallSky);
          for (const StageLight& lamp : c.lights_of(f)) {
            const Vec3f to = lamp.position - pixel->point;
            const float cosine = std::max(0.0f, to.normalized().dot(pixel->normal));
            light += lamp.intensity * (cosine / to.squaredNorm() / 3.14159265f);
          }
          mask.at(x, y)[0] = 255;
          for (int i = 0; i < 3; ++i)
            image.at(x, y)[i] = static_cast<uint8_t>(
                std::lround(255 * std::min(srgb_from_linear(pixel->albedo[i] * light[i]), 1.0f)));
        }
      write_png8(folder / stage_image_path(c.cameras[k].name, f), image);
      write_png8(folder / stage_mask_path(c.cameras[k].name, f), mask);
      if (truth) write_ball_layers(folder, c.cameras[k], f, world);
    }
  }
  c.body_keypoint_names = {"top", "left", "right"};
  c.face_keypoint_names = {"nose"};
  if (truth) c.true_poses = c.poses;
  write_stage_capture(c, folder);
  return read_stage_capture(folder);
}

}  // namespace effigy::test
