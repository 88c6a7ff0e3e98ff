#include <cmath>

#include "effigy/base/error.h"
#include "effigy/geometry/types.h"

namespace effigy {

Camera Camera::resized(int new_width, int new_height) const {
  EFFIGY_CHECK(width > 0 && height > 0 && new_width > 0 && new_height > 0);
  return cropped(0, 0, width, height, new_width, new_height);
}

// Pixel coordinates are continuous (pixel i covers [i, i + 1]), so cropping subtracts the corner
// and resizing multiplies; nothing has to be shifted by half a pixel.
Camera Camera::cropped(double x, double y, double w, double h, int out_w, int out_h) const {
  EFFIGY_CHECK(w > 0 && h > 0 && out_w > 0 && out_h > 0);
  const double scale_x = out_w / w, scale_y = out_h / h;
  Camera camera = *this;
  camera.width = out_w;
  camera.height = out_h;
  camera.fx = fx * scale_x;
  camera.fy = fy * scale_y;
  camera.cx = (cx - x) * scale_x;
  camera.cy = (cy - y) * scale_y;
  return camera;
}

Camera look_at(const Vec3d& eye, const Vec3d& target, double fov_y, int width, int height) {
  EFFIGY_CHECK(width > 0 && height > 0);
  EFFIGY_CHECK(fov_y > 0 && fov_y < M_PI);
  EFFIGY_CHECK((target - eye).norm() > 0);
  const Vec3d forward = (target - eye).normalized();
  Vec3d right = forward.cross(Vec3d::UnitY());
  // Straight up or down: any right will do; world x keeps the picture's top towards -z or +z.
  right = right.norm() > 1e-9 ? right.normalized() : Vec3d::UnitX();
  const Vec3d down = forward.cross(right);

  Camera camera;
  camera.width = width;
  camera.height = height;
  camera.fx = camera.fy = 0.5 * height / std::tan(0.5 * fov_y);
  camera.cx = 0.5 * width;
  camera.cy = 0.5 * height;
  camera.camera_from_world_rotation.row(0) = right;
  camera.camera_from_world_rotation.row(1) = down;
  camera.camera_from_world_rotation.row(2) = forward;
  camera.camera_from_world_translation = -camera.camera_from_world_rotation * eye;
  return camera;
}

}  // namespace effigy
