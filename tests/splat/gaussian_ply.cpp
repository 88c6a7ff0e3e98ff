// 3DGS PLY files: written and read, the view-dependent colour against 3DGS's own formulas, and
// files that are not what they say.
#include "effigy/splat/gaussian_ply.h"

#include <gtest/gtest.h>

#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/random.h"
#include "effigy/geometry/ply.h"
#include "support.h"

namespace effigy {
namespace {

class GaussianPly : public testing::Test {
 protected:
  const test::ScratchFolder folder;
  const Path file = folder / "a.ply";
};

GaussianModel random_model(int degree, size_t count, uint64_t seed) {
  Random random(seed);
  GaussianModel model;
  model.sh_degree = degree;
  const auto coefficients = static_cast<size_t>((degree + 1) * (degree + 1));
  Gaussians& g = model.gaussians;
  for (size_t i = 0; i < count; ++i) {
    for (int k = 0; k < 3; ++k) {
      g.center.push_back(static_cast<float>(random.normal()));
      g.scale.push_back(static_cast<float>(std::exp(random.normal() - 3.0)));
    }
    for (int k = 0; k < 4; ++k) g.rotation.push_back(static_cast<float>(random.normal()));
    g.opacity.push_back(static_cast<float>(random.uniform(0.01, 0.99)));
    for (size_t k = 0; k < 3 * coefficients; ++k)
      model.sh.push_back(static_cast<float>(0.3 * random.normal()));
  }
  return model;
}

TEST_F(GaussianPly, WhatIsWrittenIsRead) {
  for (const int degree : {0, 1, 2, 3, 4}) {
    GaussianModel out = random_model(degree, 7, 3);
    out.antialiased = degree == 2;
    write_gaussian_ply(file, out);
    // 17 floats without further harmonics, 62 with three degrees.
    const size_t floats = degree == 0 ? 17u : degree == 3 ? 62u : 0u;
    if (floats > 0) {
      EXPECT_EQ(read_ply_vertices(file).columns.size(), floats);
    }
    const GaussianModel in = read_gaussian_ply(file);
    EXPECT_EQ(in.sh_degree, degree);
    EXPECT_EQ(in.antialiased, degree == 2);
    EXPECT_EQ(in.left_out, 0u);
    EXPECT_EQ(in.gaussians.center, out.gaussians.center);
    EXPECT_EQ(in.gaussians.rotation, out.gaussians.rotation);
    EXPECT_EQ(in.sh, out.sh);
    for (size_t i = 0; i < in.count(); ++i)
      EXPECT_NEAR(in.gaussians.opacity[i], out.gaussians.opacity[i], 1e-6f);
    for (size_t i = 0; i < in.gaussians.scale.size(); ++i)
      EXPECT_NEAR(in.gaussians.scale[i], out.gaussians.scale[i], 1e-6f * out.gaussians.scale[i]);
  }
}

// The basis as 3DGS's renderer writes it out.
void reference_basis(const Vec3d& d, double* b) {
  const double x = d.x(), y = d.y(), z = d.z();
  b[0] = 0.28209479177387814;
  b[1] = -0.4886025119029199 * y;
  b[2] = 0.4886025119029199 * z;
  b[3] = -0.4886025119029199 * x;
  b[4] = 1.0925484305920792 * x * y;
  b[5] = -1.0925484305920792 * y * z;
  b[6] = 0.31539156525252005 * (2 * z * z - x * x - y * y);
  b[7] = -1.0925484305920792 * x * z;
  b[8] = 0.5462742152960396 * (x * x - y * y);
  b[9] = -0.5900435899266435 * y * (3 * x * x - y * y);
  b[10] = 2.890611442640554 * x * y * z;
  b[11] = -0.4570457994644658 * y * (4 * z * z - x * x - y * y);
  b[12] = 0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y);
  b[13] = -0.4570457994644658 * x * (4 * z * z - x * x - y * y);
  b[14] = 1.445305721320277 * z * (x * x - y * y);
  b[15] = -0.5900435899266435 * x * (x * x - 3 * y * y);
}

TEST_F(GaussianPly, ColoursDependOnTheViewAsIn3dgs) {
  const GaussianModel model = random_model(3, 40, 4);
  const Vec3d eye(0.3, -2.0, 1.5);
  std::vector<float> features;
  colour_gaussians(model, eye, features);
  int clamped = 0;
  for (size_t i = 0; i < model.count(); ++i) {
    const float* c = model.gaussians.center.data() + 3 * i;
    double basis[16];
    reference_basis((Vec3d(c[0], c[1], c[2]) - eye).normalized(), basis);
    for (size_t k = 0; k < 3; ++k) {
      double value = 0.5;
      for (size_t b = 0; b < 16; ++b)
        value += basis[b] * static_cast<double>(model.sh[48 * i + 3 * b + k]);
      clamped += value < 0;
      EXPECT_NEAR(features[3 * i + k], std::max(0.0, value), 2e-6);
    }
  }
  EXPECT_GT(clamped, 0);
}

TEST_F(GaussianPly, TheFileIsChannelAfterChannel) {
  GaussianModel model = random_model(1, 1, 5);
  for (size_t k = 0; k < 12; ++k) model.sh[k] = static_cast<float>(k);
  write_gaussian_ply(file, model);
  const PlyVertices table = read_ply_vertices(file);
  const auto at = [&](const char* name) {
    return table.values[static_cast<size_t>(table.find(name))];
  };
  EXPECT_EQ(at("f_dc_0"), 0.0f);
  EXPECT_EQ(at("f_dc_2"), 2.0f);
  EXPECT_EQ(at("f_rest_0"), 3.0f);  // red of the second coefficient
  EXPECT_EQ(at("f_rest_1"), 6.0f);
  EXPECT_EQ(at("f_rest_3"), 4.0f);  // green
  EXPECT_EQ(at("f_rest_8"), 11.0f);
}

TEST_F(GaussianPly, WhatCannotBeDrawnIsLeftOut) {
  write_gaussian_ply(file, random_model(0, 8, 6));
  PlyVertices table = read_ply_vertices(file);
  const auto at = [&](size_t row, const char* name) -> float& {
    return table.values[row * table.columns.size() + static_cast<size_t>(table.find(name))];
  };
  at(0, "x") = std::nanf("");
  at(1, "scale_1") = INFINITY;
  at(2, "scale_1") = -INFINITY;  // flat: drawn
  at(3, "opacity") = INFINITY;   // opaque: drawn
  at(4, "opacity") = std::nanf("");
  for (const char* name : {"rot_0", "rot_1", "rot_2", "rot_3"}) at(5, name) = 0.0f;
  at(6, "f_dc_1") = INFINITY;
  write_ply_vertices(file, table);
  const GaussianModel model = read_gaussian_ply(file);
  EXPECT_EQ(model.left_out, 5u);
  ASSERT_EQ(model.count(), 3u);
  EXPECT_EQ(model.gaussians.scale[1], 0.0f);
  EXPECT_EQ(model.gaussians.opacity[1], 1.0f);
  write_gaussian_ply(file, model);  // what was infinite is written as a finite number
  for (const float x : read_ply_vertices(file).values) EXPECT_TRUE(std::isfinite(x));
  for (size_t row = 0; row < 8; ++row) at(row, "y") = std::nanf("");
  write_ply_vertices(file, table);
  EXPECT_THROW(read_gaussian_ply(file), Error);
}

TEST_F(GaussianPly, FilesWithoutGaussiansAreRefused) {
  write_gaussian_ply(file, random_model(1, 2, 7));
  const PlyVertices sound = read_ply_vertices(file);
  const auto refused = [&](const std::string& column, const std::string& other) {
    PlyVertices table = sound;
    table.columns[static_cast<size_t>(table.find(column))] = other;
    write_ply_vertices(file, table);
    EXPECT_THROW(read_gaussian_ply(file), Error) << column;
  };
  for (const char* column : {"x", "opacity", "scale_2", "rot_3", "f_dc_1"})
    refused(column, "other");
  refused("f_rest_4", "other");  // four of nine
}

}  // namespace
}  // namespace effigy
