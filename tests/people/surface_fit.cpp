// How well the built-in head's identity space reaches other heads (rig/surface_fit.h).
#include "effigy/rig/surface_fit.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <map>

#include "effigy/base/error.h"
#include "effigy/base/random.h"
#include "effigy/people/builtin_head.h"
#include "effigy/rig/embedding_surface.h"
#include "effigy/rig/ict.h"

namespace effigy {
namespace {

// Somebody of the rig's own identity space, modes `spread` standard deviations off.
Mesh somebody(const Rig& rig, uint64_t seed, double spread) {
  Random random(seed);
  std::vector<float> identity;
  for (int m = 0; m < rig.identity_count; ++m)
    identity.push_back(static_cast<float>(spread * random.normal()));
  Mesh mesh = rig.mesh;
  mesh.vertices = shape_rig(rig, identity).rest;
  return mesh;
}

double mean_vertex_distance(const std::vector<float>& a, const std::vector<float>& b) {
  double sum = 0;
  for (size_t i = 0; i < a.size(); i += 3)
    sum += static_cast<double>((Vec3f(&a[i]) - Vec3f(&b[i])).norm());
  return 3 * sum / static_cast<double>(a.size());
}

TEST(SurfaceFit, FindsAKnownHead) {
  const Rig rig = builtin_head_rig();
  Mesh target = somebody(rig, 5, 0.8);
  const Eigen::Matrix3f turn =
      Eigen::AngleAxisf(0.3f, Vec3f(0.2f, 0.9f, -0.1f).normalized()).toRotationMatrix();
  for (size_t i = 0; i < target.vertices.size(); i += 3)
    Eigen::Map<Vec3f>(&target.vertices[i]) =
        turn * Vec3f(&target.vertices[i]) + Vec3f(0.1f, -0.05f, 0.4f);
  const auto marks = landmark_positions(rig.multipie, rig.mesh.triangles, target.vertices);
  const SurfaceFit fit = fit_surface(rig, target, marks);
  EXPECT_LT(fit.identity_distance, 0.3e-3);
  EXPECT_LT(fit.identity_landmark_distance, 0.5e-3);
  EXPECT_LE(fit.distance, fit.identity_distance);
  EXPECT_LT((fit.rotation - turn.cast<double>()).norm(), 0.02);
  // The vertices themselves, not only the surface, arrive near where they belong.
  EXPECT_LT(mean_vertex_distance(fitted_vertices(rig, fit, false), target.vertices), 1.5e-3);
}

TEST(SurfaceFit, ReachesTheNeutralFaceOfIct) {
  const char* data = std::getenv("EFFIGY_DATA");
  const Path folder = data == nullptr ? Path() : Path(data) / "face/ict_facekit";
  if (data == nullptr || !is_ict_folder(folder))
    GTEST_SKIP() << "set EFFIGY_DATA to a folder with face/ict_facekit";
  const Rig ict = load_ict(folder, {});
  const auto marks = landmark_positions(ict.multipie, ict.mesh.triangles, ict.mesh.vertices);
  const SurfaceFit fit = fit_surface(builtin_head_rig(), ict.mesh, marks);
  RecordProperty("identity_um", static_cast<int>(1e6 * fit.identity_distance));
  RecordProperty("offsets_um", static_cast<int>(1e6 * fit.distance));
  EXPECT_LE(fit.identity_distance, 2.5e-3);
  EXPECT_LE(fit.distance, 0.7e-3);
  EXPECT_LE(fit.landmark_distance, 1e-3);
  EXPECT_LE(fit.identity_landmark_distance, 2.5e-3);
  std::printf("surface %.2f mm by identity, %.2f mm with offsets; landmarks %.2f, %.2f mm\n",
              1e3 * fit.identity_distance, 1e3 * fit.distance, 1e3 * fit.identity_landmark_distance,
              1e3 * fit.landmark_distance);
}

// In another unit, and with few landmarks that are known.
TEST(SurfaceFit, FindsTheScaleWithFewLandmarks) {
  const Rig rig = builtin_head_rig();
  Mesh target = somebody(rig, 6, 0.5);
  for (float& x : target.vertices) x = 20 * x + 3;
  auto marks = landmark_positions(rig.multipie, rig.mesh.triangles, target.vertices);
  for (size_t i = 0; i < 68; ++i)
    if (i != 30 && i != 36 && i != 39 && i != 42 && i != 45 && i != 48 && i != 54)
      marks[3 * i] = std::nanf("");
  SurfaceFitOptions options;
  options.scale = true;
  const SurfaceFit fit = fit_surface(rig, target, marks, options);
  EXPECT_NEAR(fit.scale, 20, 1);
  EXPECT_LT(fit.identity_distance, 1e-3);
  EXPECT_LT(fit.distance, 0.5e-3);
  EXPECT_LT(fit.identity_landmark_distance, 2e-3);
  EXPECT_LT((fit.rotation - Eigen::Matrix3d::Identity()).norm(), 0.02);
  EXPECT_LT(mean_vertex_distance(fitted_vertices(rig, fit, true), target.vertices), 20 * 3e-3);
}

// Leaves of a scan what is seen from far away (not the inside of its mouth and nose) above a height
// (not its shoulders, which the rig does not have).
void keep_outside(Mesh& scan, float lowest) {
  const embedding::Surface surface(scan, "skin");
  std::vector<Vec3i> kept;
  for (const Vec3i& t : scan.triangles) {
    const Vec3d a = scan.vertex(t[0]).cast<double>(), b = scan.vertex(t[1]).cast<double>(),
                c = scan.vertex(t[2]).cast<double>(), middle = (a + b + c) / 3;
    if (std::min({a.y(), b.y(), c.y()}) < static_cast<double>(lowest)) continue;
    const Vec3d normal = (b - a).cross(c - a).normalized();
    bool seen = false;
    for (const Vec3d& aside :
         {Vec3d(0, 0, 0), Vec3d(0.6, 0, 0), Vec3d(-0.6, 0, 0), Vec3d(0, 0, 0.6)})
      seen = seen ||
             surface.last_hit(middle + 1e-3 * normal, (normal + aside).normalized()).triangle < 0;
    if (seen) kept.push_back(t);
  }
  scan.triangles = std::move(kept);
}

// Mean distance in metres of the rig from the target's points near `centre` to the fitted surface.
double distance_near(const Rig& rig, const SurfaceFit& fit, bool with_offsets, const Mesh& target,
                     const Vec3f& centre, float radius) {
  Mesh fitted = rig.mesh;
  fitted.vertices = fitted_vertices(rig, fit, with_offsets);
  const embedding::Surface surface(fitted, "skin");
  const auto normals = vertex_normals(target.vertices, target.triangles);
  std::vector<char> used(static_cast<size_t>(target.vertex_count()), 0);
  for (const Vec3i& t : target.triangles)
    for (int k = 0; k < 3; ++k) used[static_cast<size_t>(t[k])] = 1;
  double sum = 0, count = 0;
  for (int v = 0; v < target.vertex_count(); ++v) {
    const Vec3f p = target.vertex(v);
    if (!used[static_cast<size_t>(v)] || (p - centre).norm() > radius) continue;
    const auto hit = surface.closest(
        p.cast<double>(), Vec3f(&normals[3 * static_cast<size_t>(v)]).cast<double>(), 0.0);
    if (hit.triangle < 0) continue;
    sum += (hit.position - p.cast<double>()).norm() / fit.scale;
    ++count;
  }
  return sum / count;
}

// A real person's head, scanned: "Infinite, 3D Head Scan by Lee Perry-Smith" (CC BY 3.0). Its unit
// is not known, its eyes and mouth are closed. The landmarks were picked on a picture of it.
TEST(SurfaceFit, ReachesTheScanOfLeePerrySmith) {
  const char* data = std::getenv("EFFIGY_DATA");
  const Path file =
      Path(data == nullptr ? "" : data) / "face/lee_perry_smith/LeePerrySmith_decoded.obj";
  if (data == nullptr || !std::filesystem::exists(file))
    GTEST_SKIP() << "set EFFIGY_DATA to a folder with face/lee_perry_smith";
  const std::map<size_t, Vec3f> picked = {
      {27, {-0.108f, 1.802f, 2.143f}}, {30, {-0.098f, 1.168f, 2.575f}},
      {33, {-0.099f, 0.920f, 2.374f}}, {36, {-1.046f, 1.701f, 1.707f}},
      {39, {-0.411f, 1.707f, 1.844f}}, {42, {0.229f, 1.689f, 1.842f}},
      {45, {0.815f, 1.643f, 1.668f}},  {48, {-0.506f, 0.377f, 2.088f}},
      {54, {0.342f, 0.412f, 2.077f}},  {62, {-0.086f, 0.444f, 2.204f}},
      {66, {-0.086f, 0.444f, 2.204f}}};
  std::vector<float> marks(3 * 68, std::nanf(""));
  for (const auto& [mark, place] : picked)
    for (int c = 0; c < 3; ++c) marks[3 * mark + static_cast<size_t>(c)] = place[c];
  SurfaceFitOptions options;
  options.scale = true;
  options.furthest = 0.04;  // its skull is larger than the built-in head's
  Mesh scan = read_obj(file);
  keep_outside(scan, -0.9f);
  scan.uv_triangles.clear();
  scan.triangle_part.clear();
  const Rig rig = builtin_head_rig();
  const SurfaceFit fit = fit_surface(rig, scan, marks, options);
  // The face: what lies within 0.1 m of the tip of the nose.
  const auto face = [&](bool offsets) {
    return distance_near(rig, fit, offsets, scan, picked.at(30),
                         static_cast<float>(0.1 * fit.scale));
  };
  const double face_identity = face(false), face_offsets = face(true);
  std::printf("face %.2f mm by identity, %.2f mm with offsets\n", 1e3 * face_identity,
              1e3 * face_offsets);
  RecordProperty("identity_um", static_cast<int>(1e6 * fit.identity_distance));
  RecordProperty("offsets_um", static_cast<int>(1e6 * fit.distance));
  std::printf(
      "surface %.2f mm by identity, %.2f mm with offsets; landmarks %.2f, %.2f mm; a unit is "
      "%.1f mm\n",
      1e3 * fit.identity_distance, 1e3 * fit.distance, 1e3 * fit.identity_landmark_distance,
      1e3 * fit.landmark_distance, 1e3 / fit.scale);
  EXPECT_LE(fit.identity_distance, 2.8e-3);
  EXPECT_LE(fit.distance, 1e-3);
  EXPECT_LE(face_identity, 2.1e-3);
  EXPECT_LE(face_offsets, 0.6e-3);
  EXPECT_NEAR(1 / fit.scale, 0.0545, 0.002);  // chin to crown 0.24 m
}

TEST(SurfaceFit, RefusesWhatItCannotFit) {
  const Rig rig = builtin_head_rig();
  const std::vector<float> marks(3 * 68, 0.0f);
  EXPECT_THROW(fit_surface(rig, Mesh(), marks), Error);
  EXPECT_THROW(fit_surface(rig, rig.mesh, std::span(marks).first(30)), Error);
  const std::vector<float> unknown(3 * 68, std::nanf(""));
  EXPECT_THROW(fit_surface(rig, rig.mesh, unknown), Error);
}

}  // namespace
}  // namespace effigy
