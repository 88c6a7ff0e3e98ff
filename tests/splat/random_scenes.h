// Random scenes for the rasterizer's tests, one builder per kind of trouble.
#pragma once

#include <cmath>
#include <limits>

#include "effigy/base/random.h"
#include "effigy/splat/surfel_raster.h"

namespace effigy {

struct RandomScene {
  Camera camera;
  PosedSurfels surfels;
  MaterialTexture texture;
  SurfelRasterOptions options;
};

inline Vec3d random_unit(Random& random) {
  return Vec3d(random.normal(), random.normal(), random.normal()).normalized();
}

inline void append3(std::vector<float>& to, const Vec3d& v) {
  for (int k = 0; k < 3; ++k) to.push_back(static_cast<float>(v[k]));
}

// A surfel with the given geometry and random everything else.
inline void add_surfel(PosedSurfels& surfels, const Vec3d& center, const Vec3d& s, const Vec3d& t,
                       double opacity, Random& random) {
  append3(surfels.center, center);
  append3(surfels.s, s);
  append3(surfels.t, t);
  surfels.opacity.push_back(static_cast<float>(opacity));
  for (int k = 0; k < 2; ++k) surfels.uv.push_back(static_cast<float>(random.uniform(0.1, 0.9)));
  for (int k = 0; k < 4; ++k)
    surfels.uv_per_st.push_back(static_cast<float>(0.08 * random.normal()));
  const Vec3d tangent = random_unit(random);
  const Vec3d bitangent = tangent.cross(random_unit(random)).normalized();
  append3(surfels.frame, tangent);
  append3(surfels.frame, bitangent);
  append3(surfels.frame, tangent.cross(bitangent));
}

inline Camera random_camera(int width, int height, Random& random) {
  Camera camera;
  camera.width = width;
  camera.height = height;
  camera.fx = 1.1 * width;
  camera.fy = 1.2 * width;
  camera.cx = 0.5 * width + random.uniform(-1, 1);
  camera.cy = 0.5 * height + random.uniform(-1, 1);
  camera.camera_from_world_rotation =
      Eigen::AngleAxisd(random.uniform(-3, 3), random_unit(random)).toRotationMatrix();
  camera.camera_from_world_translation = Vec3d(random.normal(), random.normal(), random.normal());
  return camera;
}

// A world point at pixel (x, y) and camera depth z.
inline Vec3d world_at(const Camera& c, double x, double y, double z) {
  const Vec3d p((x - c.cx) / c.fx * z, (y - c.cy) / c.fy * z, z);
  return c.camera_from_world_rotation.transpose() * (p - c.camera_from_world_translation);
}

inline MaterialTexture random_texture(int width, int height, Random& random) {
  MaterialTexture texture(width, height);
  for (size_t i = 0; i < texture.texels.size() / 8; ++i) {
    float* texel = texture.texels.data() + 8 * i;
    for (int c = 0; c < 5; ++c) texel[c] = static_cast<float>(random.uniform());
    // One in twenty beyond the unit circle, where n_z is 0.
    const double reach = random.uniform() < 0.05 ? 1.5 : 0.6;
    for (int c = 5; c < 7; ++c) texel[c] = static_cast<float>(reach * random.uniform(-1, 1));
    texel[7] = 77.0f;  // the spare channel: must have no influence
  }
  return texture;
}

// `count` surfels in view, about `pixels` pixels a standard deviation; `facing`: smallest cosine
// between normal and view.
inline RandomScene soup(int width, int height, int count, double pixels, double facing,
                        uint64_t seed) {
  Random random(seed);
  RandomScene scene;
  scene.camera = random_camera(width, height, random);
  scene.texture = random_texture(13, 9, random);
  scene.options.low_pass = false;
  scene.options.uv_distortion = UvDistortion::kNorm;
  for (int i = 0; i < count; ++i) {
    const double z = random.uniform(2, 4);
    const Vec3d center =
        world_at(scene.camera, random.uniform(0, width), random.uniform(0, height), z);
    const Vec3d view = (center - scene.camera.center()).normalized();
    Vec3d normal = random_unit(random);
    while (std::abs(normal.dot(view)) < facing) normal = random_unit(random);
    const Vec3d s = normal.cross(random_unit(random)).normalized(), t = normal.cross(s);
    const double unit = pixels * z / scene.camera.fx;
    add_surfel(scene.surfels, center, unit * std::exp(0.4 * random.normal()) * s,
               unit * std::exp(0.4 * random.normal()) * t, random.uniform(0.1, 1.0), random);
  }
  return scene;
}

inline RandomScene plain_scene() {
  return soup(27, 22, 12, 3, 0.2, 1);
}

inline RandomScene filtered_scene() {
  RandomScene scene = soup(25, 23, 14, 0.8, 0.05, 2);
  scene.options.low_pass = true;
  return scene;
}

inline RandomScene grazing_scene() {  // normals within a few degrees of edge-on
  RandomScene scene = soup(26, 24, 0, 4, 0, 3);
  Random random(33);
  for (int i = 0; i < 14; ++i) {
    const double z = random.uniform(2, 4);
    const Vec3d center = world_at(scene.camera, random.uniform(3, 23), random.uniform(3, 21), z);
    const Vec3d view = (center - scene.camera.center()).normalized();
    const Vec3d side = view.cross(random_unit(random)).normalized();
    const Vec3d normal = (side + view * random.uniform(0.03, 0.1)).normalized();
    const Vec3d s = normal.cross(random_unit(random)).normalized(), t = normal.cross(s);
    add_surfel(scene.surfels, center, 0.35 * s, 0.45 * t, 0.8, random);
  }
  return scene;
}

inline RandomScene grazing_filtered_scene() {
  RandomScene scene = grazing_scene();
  scene.options.low_pass = true;
  return scene;
}

inline RandomScene tiny_scene() {  // far below a pixel: only the low-pass shows them
  RandomScene scene = soup(26, 22, 20, 0.01, 0.1, 4);
  scene.options.low_pass = true;
  return scene;
}

inline RandomScene stacked_scene() {  // opaque layers: clamp at 0.99 and early termination
  RandomScene scene = soup(22, 20, 24, 7, 0.5, 5);
  for (float& o : scene.surfels.opacity) o = o < 0.5f ? 1.0f : 0.97f;
  return scene;
}

inline RandomScene seam_scene() {  // lookups beyond all four edges of the texture
  RandomScene scene = soup(26, 22, 12, 4, 0.3, 6);
  Random random(66);
  for (float& x : scene.surfels.uv) x = static_cast<float>(random.uniform(-0.2, 1.2));
  for (float& x : scene.surfels.uv_per_st) x *= 3.0f;
  return scene;
}

inline RandomScene off_screen_scene() {
  RandomScene scene = soup(33, 31, 0, 0, 0, 7);
  Random random(77);
  for (int i = 0; i < 16; ++i) {
    const double angle = i * 0.4;
    const Vec3d center = world_at(scene.camera, 16 + 26 * std::cos(angle),
                                  15 + 26 * std::sin(angle), random.uniform(2, 3));
    const Vec3d normal = random_unit(random);
    const Vec3d s = normal.cross(random_unit(random)).normalized();
    add_surfel(scene.surfels, center, 0.5 * s, 0.4 * normal.cross(s), 0.7, random);
  }
  return scene;
}

inline RandomScene huge_scene() {  // much larger than the image; planes that cross the camera
  RandomScene scene = soup(26, 22, 8, 50, 0.1, 8);
  Random random(9);
  scene.texture = random_texture(5, 1, random);
  return scene;
}

inline RandomScene behind_scene() {  // centres behind the camera, some reaching into view
  RandomScene scene = soup(32, 30, 6, 4, 0.3, 9);
  Random random(99);
  for (int i = 0; i < 8; ++i) {
    const Vec3d center = world_at(scene.camera, random.uniform(-20, 50), random.uniform(-20, 50),
                                  -random.uniform(0.1, 1.0));
    const Vec3d s = random_unit(random), t = s.cross(random_unit(random)).normalized();
    add_surfel(scene.surfels, center, 1.5 * s, 1.2 * t, 0.9, random);
  }
  return scene;
}

inline RandomScene skewed_scene() {  // axes that are not orthogonal; a one-texel texture
  RandomScene scene = soup(26, 26, 12, 3, 0.4, 10);
  for (size_t i = 0; i < scene.surfels.s.size(); ++i)
    scene.surfels.t[i] += 0.6f * scene.surfels.s[i];
  Random random(3);
  scene.texture = random_texture(1, 1, random);
  return scene;
}

inline RandomScene squared_scene() {
  RandomScene scene = soup(24, 22, 14, 5, 0.3, 11);
  scene.options.uv_distortion = UvDistortion::kSquared;
  return scene;
}

inline RandomScene threshold_scene() {
  RandomScene scene = soup(24, 22, 18, 6, 0.3, 12);
  scene.options.uv_distortion_threshold = 0.3f;
  return scene;
}

inline RandomScene no_distortion_scene() {
  RandomScene scene = soup(40, 17, 14, 4, 0.3, 13);
  scene.options.uv_distortion = UvDistortion::kOff;
  return scene;
}

inline RandomScene empty_scene() {
  return soup(20, 18, 0, 1, 0, 14);
}

inline RandomScene broken_scene() {  // sound surfels between ones that must be left out
  RandomScene scene = soup(24, 22, 20, 4, 0.3, 15);
  PosedSurfels& p = scene.surfels;
  const float nan = std::nanf(""), infinity = std::numeric_limits<float>::infinity();
  p.center[3] = nan;
  p.s[3 * 2 + 1] = infinity;
  p.t[3 * 3 + 2] = nan;
  p.opacity[4] = nan;
  p.uv[2 * 5] = infinity;
  p.uv_per_st[4 * 6 + 3] = nan;
  p.frame[9 * 7 + 8] = nan;
  for (size_t k = 0; k < 3; ++k) p.s[3 * 8 + k] = 0.0f;                   // no width
  for (size_t k = 0; k < 3; ++k) p.t[3 * 9 + k] = 2.0f * p.s[3 * 9 + k];  // a line
  p.opacity[10] = 0.0f;
  p.opacity[11] = 0.003f;
  return scene;
}

struct SceneCase {
  const char* name;
  RandomScene (*make)();
};

inline constexpr SceneCase kSceneCases[] = {
    {"Plain", plain_scene},         {"Filtered", filtered_scene},
    {"Grazing", grazing_scene},     {"GrazingFiltered", grazing_filtered_scene},
    {"Tiny", tiny_scene},           {"Stacked", stacked_scene},
    {"Seam", seam_scene},           {"OffScreen", off_screen_scene},
    {"Huge", huge_scene},           {"Behind", behind_scene},
    {"Skewed", skewed_scene},       {"Squared", squared_scene},
    {"Threshold", threshold_scene}, {"NoDistortion", no_distortion_scene},
    {"Empty", empty_scene},         {"Broken", broken_scene},
};

}  // namespace effigy
