// How well the built-in head's identity space reaches other heads (rig/surface_fit.h).
#include "effigy/rig/surface_fit.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>

#include "effigy/base/error.h"
#include "effigy/base/random.h"
#include "effigy/people/builtin_head.h"
#include "effigy/rig/ict.h"

namespace effigy {
namespace {

TEST(SurfaceFit, FindsAKnownHead) {
  const Rig rig = builtin_head_rig();
  Random random(5);
  std::vector<float> identity;
  for (int m = 0; m < rig.identity_count; ++m)
    identity.push_back(static_cast<float>(0.8 * random.normal()));
  Mesh target = rig.mesh;
  target.vertices = shape_rig(rig, identity).rest;
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
  const auto fitted = fitted_vertices(rig, fit, false);
  double sum = 0;
  for (size_t i = 0; i < fitted.size(); i += 3)
    sum += static_cast<double>((Vec3f(&fitted[i]) - Vec3f(&target.vertices[i])).norm());
  EXPECT_LT(3 * sum / static_cast<double>(fitted.size()), 1.5e-3);
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

TEST(SurfaceFit, RefusesWhatItCannotFit) {
  const Rig rig = builtin_head_rig();
  const std::vector<float> marks(3 * 68, 0.0f);
  EXPECT_THROW(fit_surface(rig, Mesh(), marks), Error);
  EXPECT_THROW(fit_surface(rig, rig.mesh, std::span(marks).first(30)), Error);
}

}  // namespace
}  // namespace effigy
