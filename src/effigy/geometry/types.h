// Vector types used everywhere (Eigen), and pinhole cameras.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace effigy {

using Vec2f = Eigen::Vector2f;
using Vec3f = Eigen::Vector3f;
using Vec4f = Eigen::Vector4f;
using Vec3i = Eigen::Vector3i;
using Vec2d = Eigen::Vector2d;
using Vec3d = Eigen::Vector3d;
using Mat3f = Eigen::Matrix3f;
using Mat3d = Eigen::Matrix3d;
using Mat4d = Eigen::Matrix4d;

// Pinhole camera, OpenCV axes (x right, y down, z forward), pixel centres at +0.5:
// x_cam = rotation * x_world + translation, u = fx x/z + cx, v = fy y/z + cy.
struct Camera {
  int width = 0, height = 0;
  double fx = 0, fy = 0, cx = 0, cy = 0;
  Mat3d camera_from_world_rotation = Mat3d::Identity();
  Vec3d camera_from_world_translation = Vec3d::Zero();

  Vec3d center() const {
    return -camera_from_world_rotation.transpose() * camera_from_world_translation;
  }
  Vec3d to_camera(const Vec3d& world) const {
    return camera_from_world_rotation * world + camera_from_world_translation;
  }
  // Pixel position of a world point in front of the camera.
  Vec2d project(const Vec3d& world) const {
    const Vec3d p = to_camera(world);
    return {fx * p.x() / p.z() + cx, fy * p.y() / p.z() + cy};
  }
  // The same camera for an image resized to width x height pixels.
  Camera resized(int new_width, int new_height) const;
  // The same camera for the crop whose top-left corner is (x, y), w x h pixels, resized to
  // out_w x out_h.
  Camera cropped(double x, double y, double w, double h, int out_w, int out_h) const;
};

// Camera at `eye` looking at `target`, world y up, vertical field of view in radians.
Camera look_at(const Vec3d& eye, const Vec3d& target, double fov_y, int width, int height);

}  // namespace effigy
