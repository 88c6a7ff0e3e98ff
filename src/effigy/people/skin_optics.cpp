#include "effigy/people/skin_optics.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

namespace effigy {
namespace {

constexpr double kMelaninLow = 0.003, kMelaninHigh = 0.4;
constexpr double kBloodLow = 0.001, kBloodHigh = 0.1;

// Molar extinction of oxygenated and deoxygenated haemoglobin, 1/(cm M).
struct Extinction {
  double wavelength, oxygenated, bare;
};
constexpr std::array<Extinction, 23> kHaemoglobin = {
    {{400, 266232, 223296}, {420, 480360, 407560}, {430, 246072, 528600}, {440, 102580, 413280},
     {450, 62816, 103292},  {460, 44480, 23389},   {480, 26629, 14550},   {500, 20933, 20862},
     {520, 24202, 31590},   {530, 39957, 39036},   {540, 53236, 46592},   {550, 43016, 53412},
     {560, 32613, 53788},   {570, 44496, 45072},   {576, 55540, 40092},   {580, 50104, 37020},
     {590, 14401, 28324},   {600, 3200, 14677},    {620, 942, 6510},      {640, 442, 4345},
     {660, 320, 3227},      {680, 278, 2408},      {700, 290, 1794}}};

// CIE standard illuminant D65, 400 to 700 nm in steps of 10.
constexpr std::array<double, 31> kDaylight = {
    82.75,  91.49,  93.43,  86.68,  104.86, 117.01, 117.81, 114.86, 115.92, 108.81, 109.35,
    107.80, 104.79, 107.69, 104.41, 104.05, 100.00, 96.33,  95.79,  88.69,  90.01,  89.60,
    87.70,  83.29,  83.70,  80.03,  80.21,  82.28,  78.28,  69.72,  71.61};

// 1/cm; a quarter of the blood's haemoglobin is without oxygen, 150 g/l.
double blood_absorption(double wavelength) {
  constexpr double kSaturation = 0.75;
  size_t i = 1;
  while (i + 1 < kHaemoglobin.size() && kHaemoglobin[i].wavelength < wavelength) ++i;
  const Extinction &a = kHaemoglobin[i - 1], &b = kHaemoglobin[i];
  const double t =
      std::clamp((wavelength - a.wavelength) / (b.wavelength - a.wavelength), 0.0, 1.0);
  auto between = [t](double x, double y) {
    return std::exp((1 - t) * std::log(x) + t * std::log(y));
  };
  const double molar = kSaturation * between(a.oxygenated, b.oxygenated) +
                       (1 - kSaturation) * between(a.bare, b.bare);
  return std::numbers::ln10 * 150 * molar / 64500;
}

double lobe(double x, double middle, double below, double above) {
  const double t = (x - middle) / (x < middle ? below : above);
  return std::exp(-0.5 * t * t);
}
Vec3d colour_matching(double w) {
  return {1.056 * lobe(w, 599.8, 37.9, 31.0) + 0.362 * lobe(w, 442.0, 16.0, 26.7) -
              0.065 * lobe(w, 501.1, 20.4, 26.2),
          0.821 * lobe(w, 568.8, 46.9, 40.5) + 0.286 * lobe(w, 530.9, 16.3, 31.1),
          1.217 * lobe(w, 437.0, 11.8, 36.0) + 0.681 * lobe(w, 459.0, 26.0, 13.8)};
}

// Linear sRGB under D65, 1 for a perfect reflector.
template <typename Reflectance>
Vec3d linear_srgb(Reflectance reflectance) {
  Eigen::Matrix3d rgb_from_xyz;
  rgb_from_xyz << 3.2404542, -1.5371385, -0.4985314, -0.9692660, 1.8760108, 0.0415560, 0.0556434,
      -0.2040259, 1.0572252;
  Vec3d seen = Vec3d::Zero(), white = Vec3d::Zero();
  for (size_t i = 0; i < kDaylight.size(); ++i) {
    const double wavelength = 400 + 10.0 * static_cast<double>(i);
    const Vec3d xyz = kDaylight[i] * colour_matching(wavelength);
    seen += reflectance(wavelength) * xyz;
    white += xyz;
  }
  return (rgb_from_xyz * seen).cwiseQuotient(rgb_from_xyz * white);
}

// Logarithms of the colour over the logarithms of both fractions.
class Table {
 public:
  Table() : values_(static_cast<size_t>(kSize) * kSize) {
    for (int m = 0; m < kSize; ++m)
      for (int b = 0; b < kSize; ++b) {
        const double melanin =
            kMelaninLow * std::pow(kMelaninHigh / kMelaninLow, m / (kSize - 1.0));
        const double blood = kBloodLow * std::pow(kBloodHigh / kBloodLow, b / (kSize - 1.0));
        const Vec3d rgb =
            linear_srgb([&](double w) { return skin_reflectance(w, melanin, blood); });
        values_[static_cast<size_t>(m * kSize + b)] = rgb.cwiseMax(1e-4).array().log();
      }
  }
  Vec3d at(double melanin, double blood) const {
    const double x = place(melanin, kMelaninLow, kMelaninHigh);
    const double y = place(blood, kBloodLow, kBloodHigh);
    const int i = std::min(static_cast<int>(x), kSize - 2),
              j = std::min(static_cast<int>(y), kSize - 2);
    const Vec3d* v = &values_[static_cast<size_t>(i * kSize + j)];
    const double fx = x - i, fy = y - j;
    const Vec3d value =
        (1 - fx) * ((1 - fy) * v[0] + fy * v[1]) + fx * ((1 - fy) * v[kSize] + fy * v[kSize + 1]);
    return value.array().exp();
  }

 private:
  static constexpr int kSize = 24;
  static double place(double x, double low, double high) {
    return (kSize - 1) * std::log(std::clamp(x, low, high) / low) / std::log(high / low);
  }
  std::vector<Vec3d> values_;
};

}  // namespace

double skin_reflectance(double wavelength, double melanin, double blood) {
  melanin = std::clamp(melanin, kMelaninLow, kMelaninHigh);
  blood = std::clamp(blood, kBloodLow, kBloodHigh);
  const double base = 0.244 + 85.3 * std::exp(-(wavelength - 154) / 66.2);
  const double epidermis = melanin * 6.6e11 * std::pow(wavelength, -3.33) + (1 - melanin) * base;
  // 0.1 mm, crossed twice at a slant.
  const double through = std::exp(-2 * epidermis * 0.01 * 1.5);
  const double dermis = blood * blood_absorption(wavelength) + (1 - blood) * base;
  const double scattering =
      14.74 * std::pow(wavelength / 500, -0.22) + 2.2e11 * std::pow(wavelength, -4);
  const double albedo = scattering / (scattering + dermis);
  constexpr double kInternal = (1 + 0.529) / (1 - 0.529);  // reflection at the surface, n = 1.4
  const double s = std::sqrt(3 * (1 - albedo));
  const double below = 0.5 * albedo * (1 + std::exp(-4.0 / 3.0 * kInternal * s)) * std::exp(-s);
  // What the epidermis itself scatters back, single scattering over its depth: without it dark skin
  // would have no blue at all.
  constexpr double kBackwards = 0.1;
  const double above = kBackwards * scattering * (1 - through) / epidermis;
  return through * below + above;
}

Vec3d skin_albedo(double melanin, double blood) {
  static const Table table;
  return table.at(melanin, blood);
}

}  // namespace effigy
