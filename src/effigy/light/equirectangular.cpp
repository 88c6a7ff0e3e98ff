#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <span>
#include <vector>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/light/environment.h"

// Equirectangular image -> cubemap by exact areas. The sphere is cut into meridians (lines of one
// longitude). Along a meridian the borders of image rows and of cubemap texels are known in closed
// form, so the light between two texel borders is a difference of the image column's cumulative
// sum; across meridians we integrate by Gauss quadrature between all borders of image columns and
// of the side faces' texel columns (which are meridians themselves). Every bit of every meridian
// goes to one texel, hence a sun of one pixel keeps its flux; dividing by the solid angle collected
// the same way makes constant light exactly constant.

namespace effigy {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr int kParts = 4;  // fixed, so that the result does not depend on the thread count

struct Segment {
  double begin, end;  // longitude in the cubemap's frame
};

// Flux (3) and solid angle per texel.
using Sums = std::vector<std::array<double, 4>>;

// Cumulative radiance x d(cos theta) of one image column from the north pole down.
class Column {
 public:
  Column(const Image& image, std::span<const double> row_cosine)
      : image_(image), row_cosine_(row_cosine), cumulative_(image.height + size_t{1}) {}

  void select(int column) {
    if (column == column_) return;
    column_ = column;
    cumulative_[0] = {0, 0, 0};
    for (int row = 0; row < image_.height; ++row) {
      const double height = row_cosine_[row] - row_cosine_[row + 1];
      for (int c = 0; c < 3; ++c)
        cumulative_[row + 1][c] = cumulative_[row][c] + height * radiance(row, c);
    }
  }
  // Integral from the north pole to the polar angle whose cosine is given. `row`: where to search
  // from; 0 at the pole, then left for the next, lower angle.
  std::array<double, 3> integral(double cosine, int& row) const {
    while (row + 1 < image_.height && row_cosine_[row + 1] > cosine) ++row;
    std::array<double, 3> value;
    for (int c = 0; c < 3; ++c)
      value[c] = cumulative_[row][c] + (row_cosine_[row] - cosine) * radiance(row, c);
    return value;
  }

 private:
  double radiance(int row, int c) const {
    return image_.at(column_, row)[image_.channels >= 3 ? c : 0];
  }
  const Image& image_;
  std::span<const double> row_cosine_;
  std::vector<std::array<double, 3>> cumulative_;
  int column_ = -1;
};

// A texel of the +y face crossed by a meridian, up to tangent `reach` from the pole.
struct Crossing {
  int x, z;
  double reach;
};

// Cells of the n x n grid over [-1, 1]^2 that a ray from the origin in direction (hx, hz) crosses.
void cross_top_face(double hx, double hz, int n, std::vector<Crossing>& crossings) {
  crossings.clear();
  const auto start = [n](double h) { return h < 0 ? (n - 1) / 2 : n / 2; };
  const auto border = [n](int cell, double h) {  // distance to the cell's far border
    if (h == 0) return 1e30;
    return (-1.0 + 2.0 * (h > 0 ? cell + 1 : cell) / n) / h;
  };
  int x = start(hx), z = start(hz);
  while (x >= 0 && x < n && z >= 0 && z < n) {
    const double to_x = border(x, hx), to_z = border(z, hz);
    crossings.push_back({x, z, std::min(to_x, to_z)});
    if (to_x <= to_z) {
      x += hx > 0 ? 1 : -1;
    } else {
      z += hz > 0 ? 1 : -1;
    }
  }
}

// Adds one meridian of width `weight` radians.
void add_meridian(double longitude, double weight, const Column& column, int n,
                  std::vector<Crossing>& crossings, Sums& sums) {
  const double hx = std::sin(longitude), hz = -std::cos(longitude);
  double cosine = 1.0;
  int row = 0;
  std::array<double, 3> below = {0, 0, 0};
  const auto step = [&](int face, int x, int y, double next) {
    const std::array<double, 3> upto = column.integral(next, row);
    auto& sum = sums[(static_cast<size_t>(face) * n + y) * n + x];
    for (int c = 0; c < 3; ++c) sum[c] += weight * (upto[c] - below[c]);
    sum[3] += weight * (cosine - next);
    cosine = next;
    below = upto;
  };
  cross_top_face(hx, hz, n, crossings);
  for (const Crossing& c : crossings) step(2, c.x, c.z, 1.0 / std::sqrt(1.0 + c.reach * c.reach));
  const bool on_x = std::abs(hx) >= std::abs(hz);
  const double major = on_x ? std::abs(hx) : std::abs(hz);
  const int face = on_x ? (hx > 0 ? 0 : 1) : (hz > 0 ? 4 : 5);
  const double s = (on_x ? (hx > 0 ? -hz : hz) : (hz > 0 ? hx : -hx)) / major;
  const int x = std::clamp(static_cast<int>((s + 1.0) * 0.5 * n), 0, n - 1);
  for (int y = 0; y < n; ++y) {
    const double tangent = (1.0 - 2.0 * (y + 1) / n) * major;  // of the elevation
    step(face, x, y, tangent / std::sqrt(1.0 + tangent * tangent));
  }
  for (size_t i = crossings.size(); i-- > 0;) {
    const double reach = i > 0 ? crossings[i - 1].reach : 0.0;
    step(3, crossings[i].x, n - 1 - crossings[i].z, -1.0 / std::sqrt(1.0 + reach * reach));
  }
}

std::vector<Segment> meridian_segments(int width, int n, double rotation) {
  std::vector<double> cuts = {-kPi, kPi};
  const auto add = [&](double longitude) {
    longitude = std::remainder(longitude, 2.0 * kPi);
    cuts.push_back(longitude);
  };
  for (int i = 0; i < width; ++i) add(-kPi + 2.0 * kPi * i / width - rotation);
  for (int face = 0; face < 4; ++face)
    for (int i = 0; i < n; ++i) add(0.5 * kPi * face + std::atan(-1.0 + 2.0 * i / n));
  std::sort(cuts.begin(), cuts.end());
  std::vector<Segment> segments;
  // Texel corners of the top and bottom faces lie between meridians: narrow pieces resolve them.
  const double widest = std::max(kPi / (32.0 * n), kPi / 4096.0);
  for (size_t i = 0; i + 1 < cuts.size(); ++i) {
    const double width_i = cuts[i + 1] - cuts[i];
    if (width_i <= 1e-12) continue;
    const int pieces = static_cast<int>(std::ceil(width_i / widest));
    for (int k = 0; k < pieces; ++k)
      segments.push_back({cuts[i] + width_i * k / pieces, cuts[i] + width_i * (k + 1) / pieces});
  }
  return segments;
}

}  // namespace

Cubemap cubemap_from_equirectangular(const Image& image, int size, double rotation) {
  EFFIGY_CHECK(size >= 1 && size <= 4096);
  if (image.width < 2 || image.height < 1 ||
      std::abs(image.width - 2.0 * image.height) > 0.1 * image.width)
    throw Error("An environment image must be about twice as wide as high (equirectangular), got " +
                std::to_string(image.width) + " x " + std::to_string(image.height) + " pixels.");
  EFFIGY_CHECK(image.channels >= 1);
  const std::vector<Segment> segments = meridian_segments(image.width, size, rotation);
  std::vector<double> row_cosine(static_cast<size_t>(image.height) + 1);
  for (int row = 0; row <= image.height; ++row)
    row_cosine[row] = std::cos(kPi * row / image.height);
  row_cosine.back() = -1.0;
  const size_t texels = static_cast<size_t>(6) * size * size;
  std::array<Sums, kParts> parts;
  run_slots(kParts, [&](int part) {
    Sums& sums = parts[part];
    sums.assign(texels, {0, 0, 0, 0});
    Column column(image, row_cosine);
    std::vector<Crossing> crossings;
    for (size_t i = segments.size() * part / kParts; i < segments.size() * (part + 1) / kParts;
         ++i) {
      const double middle = 0.5 * (segments[i].begin + segments[i].end);
      const double half = 0.5 * (segments[i].end - segments[i].begin);
      double u = (middle + rotation) / (2.0 * kPi) + 0.5;
      u -= std::floor(u);
      column.select(std::min(static_cast<int>(u * image.width), image.width - 1));
      // Three-point Gauss-Legendre.
      const double offset = half * std::sqrt(0.6);
      add_meridian(middle - offset, half * 5.0 / 9.0, column, size, crossings, sums);
      add_meridian(middle, half * 8.0 / 9.0, column, size, crossings, sums);
      add_meridian(middle + offset, half * 5.0 / 9.0, column, size, crossings, sums);
    }
  });
  Cubemap cubemap(size);
  for (size_t i = 0; i < texels; ++i) {
    std::array<double, 4> sum = {0, 0, 0, 0};
    for (const Sums& part : parts)
      for (int c = 0; c < 4; ++c) sum[c] += part[i][c];
    for (int c = 0; c < 3; ++c)
      cubemap.texels[3 * i + c] = sum[3] > 0 ? static_cast<float>(sum[c] / sum[3]) : 0.0f;
  }
  return cubemap;
}

}  // namespace effigy
