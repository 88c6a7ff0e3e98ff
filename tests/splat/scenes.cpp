// The rasterizers against scenes whose answers were computed elsewhere in double precision: every
// folder under $EFFIGY_SCENES (scene.json, texture.f32, upstream_*.f32, expected/*.f32).

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>

#include "effigy/splat/gaussian_scene_file.h"
#include "effigy/splat/scene_file.h"
#include "splat/oracle.h"
#include "support.h"

namespace effigy {
namespace {

std::vector<float> read_raw(const Path& file) {
  const std::vector<uint8_t> bytes = read_file(file);
  std::vector<float> values(bytes.size() / sizeof(float));
  std::memcpy(values.data(), bytes.data(), values.size() * sizeof(float));
  return values;
}

// 99.9th percentile of the error over the largest expected value.
double output_error(const std::vector<float>& expected, const std::vector<float>& actual) {
  std::vector<double> errors;
  double largest = 1e-20;
  for (size_t i = 0; i < expected.size(); ++i) {
    if (std::isnan(expected[i])) continue;
    largest = std::max(largest, std::abs(static_cast<double>(expected[i])));
    const double e = std::abs(static_cast<double>(expected[i]) - static_cast<double>(actual[i]));
    errors.push_back(std::isnan(e) ? 1e30 : e);
  }
  if (errors.empty()) return 0.0;
  const size_t rank = std::min(errors.size() - 1, errors.size() * 999 / 1000);
  std::nth_element(errors.begin(), errors.begin() + static_cast<std::ptrdiff_t>(rank),
                   errors.end());
  return errors[rank] / largest;
}

double gradient_error(const std::vector<float>& expected, const std::vector<float>& actual) {
  double error = 0, size = 0;
  for (size_t i = 0; i < expected.size(); ++i) {
    if (std::isnan(expected[i])) continue;
    const double e = static_cast<double>(expected[i]) - static_cast<double>(actual[i]);
    error += std::isnan(e) ? 1e30 : e * e;
    size += static_cast<double>(expected[i]) * static_cast<double>(expected[i]);
  }
  return std::sqrt(error / std::max(size, 1e-30));
}

// The answers were made with finite differences of step 1e-6 and leave out (NaN) most of those
// whose step crosses a threshold. A few steps that cross the border between two texels, where the
// lookup has a kink, were kept. They are found here: where ours differs noticeably and the oracle
// takes different decisions at the two ends of the step, the entry is left out as well.
int leave_out_crossed_steps(const SplatScene& scene, const std::string& name,
                            const std::vector<float>& actual, std::vector<float>& expected) {
  oracle::Scene wide =
      oracle::make_scene(scene.camera, scene.surfels, scene.texture, splat_scene_options());
  std::vector<double>* parameter = nullptr;
  if (name == "grad_center.f32") parameter = &wide.surfels.center;
  if (name == "grad_s.f32") parameter = &wide.surfels.s;
  if (name == "grad_t.f32") parameter = &wide.surfels.t;
  if (!parameter) return 0;
  double size = 0;
  for (const float x : expected)
    if (!std::isnan(x)) size += static_cast<double>(x) * static_cast<double>(x);
  int left_out = 0;
  for (size_t i = 0; i < expected.size(); ++i) {
    if (std::isnan(expected[i])) continue;
    if (std::abs(static_cast<double>(expected[i] - actual[i])) < 1e-3 * std::sqrt(size)) continue;
    const double at = (*parameter)[i];
    (*parameter)[i] = at + 1e-6;
    const uint64_t above = oracle::render(wide).signature;
    (*parameter)[i] = at - 1e-6;
    const uint64_t below = oracle::render(wide).signature;
    (*parameter)[i] = at;
    if (above == below) continue;
    expected[i] = std::nanf("");
    ++left_out;
  }
  return left_out;
}

// Draws every scene of a kind: write_answers(folder, out) writes into `out` what stands in the
// scene's `expected`, which is compared; leave_out(folder, name, actual, expected) may set values
// of a gradient to NaN that finite differences cannot tell, and says of how many.
template <typename WriteAnswers, typename LeaveOut>
void expect_answers(SplatSceneKind kind, int least_files, const WriteAnswers& write_answers,
                    const LeaveOut& leave_out) {
  const Path root = test::outside_data("EFFIGY_SCENES");
  if (root.empty()) GTEST_SKIP() << "EFFIGY_SCENES is not set: no scenes with known answers";
  int scenes = 0;
  for (const auto& entry : std::filesystem::directory_iterator(root)) {
    const Path folder = entry.path();
    if (!std::filesystem::exists(folder / "scene.json")) continue;
    if (splat_scene_kind(folder) != kind) continue;
    SCOPED_TRACE(folder.string());
    ++scenes;
    const test::ScratchFolder out;
    write_answers(folder, out.path());
    int files = 0;
    for (const auto& answer : std::filesystem::directory_iterator(folder / "expected")) {
      const std::string name = answer.path().filename().string();
      std::vector<float> expected = read_raw(answer.path());
      const std::vector<float> actual = read_raw(out / name);
      ASSERT_EQ(expected.size(), actual.size()) << name;
      ++files;
      const bool gradient = name.rfind("grad_", 0) == 0;
      if (gradient) {
        EXPECT_LE(leave_out(folder, name, actual, expected), 2) << name;
      }
      const double error =
          gradient ? gradient_error(expected, actual) : output_error(expected, actual);
      if (std::getenv("EFFIGY_VERBOSE"))
        std::cerr << folder.filename().string() << " " << name << " " << error << "\n";
      EXPECT_LE(error, 2e-3) << name;
    }
    EXPECT_GE(files, least_files);
  }
  EXPECT_GT(scenes, 0) << "no scenes of this kind in " << root;
}

TEST(SplatScenes, AgreeWithTheirAnswers) {
  const auto write_answers = [](const Path& folder, const Path& out) {
    const SplatScene scene = read_splat_scene(folder);
    const SurfelRasterOptions options = splat_scene_options();
    Planes gbuffer;
    SurfelFrame frame;
    render_surfels(scene.camera, scene.surfels, scene.texture, options, gbuffer, frame);
    write_splat_outputs(out, gbuffer);
    if (!std::filesystem::exists(folder / "upstream_alpha.f32")) return;
    PosedSurfels d_surfels;
    d_surfels.resize(scene.surfels.count());
    std::vector<float> d_texels(scene.texture.texels.size());
    render_surfels_backward(scene.camera, scene.surfels, scene.texture, options, gbuffer, frame,
                            read_splat_upstream(folder, scene.camera), d_surfels, d_texels);
    write_splat_gradients(out, d_surfels, d_texels);
  };
  const auto leave_out = [](const Path& folder, const std::string& name,
                            const std::vector<float>& actual, std::vector<float>& expected) {
    return leave_out_crossed_steps(read_splat_scene(folder), name, actual, expected);
  };
  expect_answers(SplatSceneKind::kSurfels, 7, write_answers, leave_out);
}

TEST(GaussianScenes, AgreeWithTheirAnswers) {
  const auto write_answers = [](const Path& folder, const Path& out) {
    const GaussianScene scene = read_gaussian_scene(folder);
    Planes image;
    GaussianFrame frame;
    render_gaussians(scene.camera, scene.gaussians.view(), {}, image, frame);
    write_gaussian_outputs(out, image);
    if (!std::filesystem::exists(folder / "upstream_alpha.f32")) return;
    Gaussians d;
    d.channels = scene.gaussians.channels;
    d.resize(scene.gaussians.count());
    render_gaussians_backward(scene.camera, scene.gaussians.view(), {}, image, frame,
                              read_gaussian_upstream(folder, scene),
                              {d.center, d.rotation, d.scale, d.opacity, d.features, {}});
    write_gaussian_gradients(out, d);
  };
  const auto nothing = [](const Path&, const std::string&, const std::vector<float>&,
                          std::vector<float>&) { return 0; };
  expect_answers(SplatSceneKind::kGaussians, 2, write_answers, nothing);
}

}  // namespace
}  // namespace effigy
