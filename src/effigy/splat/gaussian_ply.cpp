#include "effigy/splat/gaussian_ply.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/geometry/ply.h"
#include "effigy/light/spherical_harmonics.h"

namespace effigy {
namespace {

constexpr int kMostDegree = 4;
constexpr float kLargestLogit = 30.0f;  // a sigmoid of 1 in single precision

float sigmoid(float x) {
  return 1.0f / (1.0f + std::exp(-x));
}

float logit(float p) {
  const float clamped = std::clamp(p, 1e-9f, 1.0f);
  return std::min(kLargestLogit, std::log(clamped) - std::log1p(-clamped));
}

// Where the columns of a 3DGS file are.
struct Columns {
  size_t center[3], rotation[4], scale[3], opacity, dc[3];
  std::vector<size_t> rest;

  Columns(const PlyVertices& table, const Path& path) {
    const auto column = [&](const std::string& name) {
      const int found = table.find(name);
      if (found < 0)
        throw Error(path.string() + ": has no vertex column '" + name +
                    "', so it is not a 3D Gaussian PLY; export it in the 3DGS layout.");
      return static_cast<size_t>(found);
    };
    const char* const axes[] = {"x", "y", "z"};
    for (size_t k = 0; k < 3; ++k) {
      center[k] = column(axes[k]);
      scale[k] = column("scale_" + std::to_string(k));
      dc[k] = column("f_dc_" + std::to_string(k));
    }
    for (size_t k = 0; k < 4; ++k) rotation[k] = column("rot_" + std::to_string(k));
    opacity = column("opacity");
    for (int k = 0; table.find("f_rest_" + std::to_string(k)) >= 0; ++k)
      rest.push_back(column("f_rest_" + std::to_string(k)));
  }
};

int degree_of(size_t rest, const Path& path) {
  for (int degree = 0; degree <= kMostDegree; ++degree)
    if (rest == 3 * (sh_count(degree) - 1)) return degree;
  throw Error(path.string() + ": has " + std::to_string(rest) +
              " columns f_rest_*; a 3D Gaussian PLY has 0, 9, 24, 45 or 72.");
}

bool is_antialiased(const std::vector<std::string>& comments) {
  const auto has = [&](const char* text) {
    return std::find(comments.begin(), comments.end(), text) != comments.end();
  };
  return has("SplatRenderMode: mip") || has("antialiased 1");
}

}  // namespace

GaussianModel read_gaussian_ply(const Path& path) {
  const PlyVertices table = read_ply_vertices(path);
  const Columns columns(table, path);
  GaussianModel model;
  model.sh_degree = degree_of(columns.rest.size(), path);
  model.antialiased = is_antialiased(table.comments);
  Gaussians& g = model.gaussians;
  const size_t coefficients = sh_count(model.sh_degree);
  std::vector<float> row_sh(3 * coefficients);
  for (size_t row = 0; row < table.count(); ++row) {
    const float* values = table.values.data() + row * table.columns.size();
    float center[3], scale[3], rotation[4], length = 0.0f, sum = 0.0f;
    for (size_t k = 0; k < 3; ++k) {
      center[k] = values[columns.center[k]];
      scale[k] = std::exp(values[columns.scale[k]]);
      sum += std::abs(center[k]) + scale[k];
      row_sh[k] = values[columns.dc[k]];
      for (size_t c = 1; c < coefficients; ++c)
        row_sh[3 * c + k] = values[columns.rest[k * (coefficients - 1) + c - 1]];
    }
    for (size_t k = 0; k < 4; ++k) {
      rotation[k] = values[columns.rotation[k]];
      length += rotation[k] * rotation[k];
    }
    for (const float c : row_sh) sum += std::abs(c);
    const float opacity = sigmoid(values[columns.opacity]);
    if (!std::isfinite(sum) || !std::isfinite(length) || !(length > 0.0f) ||
        !std::isfinite(opacity)) {
      ++model.left_out;
      continue;
    }
    g.center.insert(g.center.end(), center, center + 3);
    g.scale.insert(g.scale.end(), scale, scale + 3);
    g.rotation.insert(g.rotation.end(), rotation, rotation + 4);
    g.opacity.push_back(opacity);
    model.sh.insert(model.sh.end(), row_sh.begin(), row_sh.end());
  }
  if (g.count() == 0)
    throw Error(path.string() + ": holds no Gaussian that can be drawn; export it again.");
  return model;
}

void write_gaussian_ply(const Path& path, const GaussianModel& model) {
  const Gaussians& g = model.gaussians;
  const size_t n = model.count(), coefficients = sh_count(model.sh_degree);
  EFFIGY_CHECK_EQ(model.sh.size(), 3 * coefficients * n);
  PlyVertices table;
  table.comments = {std::string("SplatRenderMode: ") + (model.antialiased ? "mip" : "default")};
  table.columns = {"x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"};
  for (size_t k = 0; k < 3 * (coefficients - 1); ++k)
    table.columns.push_back("f_rest_" + std::to_string(k));
  table.columns.push_back("opacity");
  for (size_t k = 0; k < 3; ++k) table.columns.push_back("scale_" + std::to_string(k));
  for (size_t k = 0; k < 4; ++k) table.columns.push_back("rot_" + std::to_string(k));
  std::vector<float>& to = table.values;
  to.reserve(n * table.columns.size());
  for (size_t i = 0; i < n; ++i) {
    const float* sh = model.sh.data() + 3 * coefficients * i;
    to.insert(to.end(), g.center.begin() + static_cast<std::ptrdiff_t>(3 * i),
              g.center.begin() + static_cast<std::ptrdiff_t>(3 * i + 3));
    to.insert(to.end(), 3, 0.0f);
    to.insert(to.end(), sh, sh + 3);
    for (size_t k = 0; k < 3; ++k)
      for (size_t c = 1; c < coefficients; ++c) to.push_back(sh[3 * c + k]);
    to.push_back(logit(g.opacity[i]));
    // A scale of zero would be minus infinity, which other readers refuse.
    for (size_t k = 0; k < 3; ++k) to.push_back(std::log(std::max(1e-12f, g.scale[3 * i + k])));
    to.insert(to.end(), g.rotation.begin() + static_cast<std::ptrdiff_t>(4 * i),
              g.rotation.begin() + static_cast<std::ptrdiff_t>(4 * i + 4));
  }
  write_ply_vertices(path, table);
}

void colour_gaussians(const GaussianModel& model, const Vec3d& eye, std::vector<float>& features) {
  const size_t n = model.count(), coefficients = sh_count(model.sh_degree);
  features.resize(3 * n);
  parallel_for(n, 512, [&](size_t begin, size_t end, int) {
    float basis[sh_count(kMostDegree)];
    for (size_t i = begin; i < end; ++i) {
      const float* c = model.gaussians.center.data() + 3 * i;
      const Vec3d to = Vec3d(c[0], c[1], c[2]) - eye;
      const Vec3f direction = (to / std::max(1e-20, to.norm())).cast<float>();
      evaluate_sh(model.sh_degree, direction.data(), basis);
      const float* sh = model.sh.data() + 3 * coefficients * i;
      float rgb[3] = {0.5f, 0.5f, 0.5f};
      for (size_t k = 0; k < coefficients; ++k)
        for (size_t ch = 0; ch < 3; ++ch) rgb[ch] += basis[k] * sh[3 * k + ch];
      for (size_t ch = 0; ch < 3; ++ch) features[3 * i + ch] = std::max(0.0f, rgb[ch]);
    }
  });
}

}  // namespace effigy
