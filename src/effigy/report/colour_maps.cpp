#include <algorithm>
#include <cmath>
#include <numbers>

#include "effigy/base/error.h"
#include "effigy/image/colour.h"
#include "effigy/report/overlay.h"

namespace effigy {
namespace {

// Oklab (Ottosson 2020) to sRGB bytes.
Rgb8 from_oklab(double lightness, double a, double b) {
  const double l = std::pow(lightness + 0.3963377774 * a + 0.2158037573 * b, 3);
  const double m = std::pow(lightness - 0.1055613458 * a - 0.0638541728 * b, 3);
  const double s = std::pow(lightness - 0.0894841775 * a - 1.2914855480 * b, 3);
  const double linear[3] = {4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
                            -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
                            -0.0041960863 * l - 0.7034186147 * m + 1.7076147010 * s};
  Rgb8 rgb{};
  for (size_t c = 0; c < 3; ++c) {
    const float encoded = srgb_from_linear(static_cast<float>(std::clamp(linear[c], 0.0, 1.0)));
    rgb[c] = static_cast<uint8_t>(std::lround(255.0f * encoded));
  }
  return rgb;
}

std::array<Rgb8, 256> make_perceptual_map() {
  std::array<Rgb8, 256> map{};
  for (size_t i = 0; i < 256; ++i) {
    const double t = static_cast<double>(i) / 255.0;
    const double lightness = 0.24 + 0.70 * t;
    // From blue through violet, red and orange to yellow; less chroma at both ends, where the
    // display's gamut is narrow.
    const double hue = (-85.0 + 185.0 * t) * std::numbers::pi / 180.0;
    const double chroma = 0.07 + 0.11 * std::sin(std::numbers::pi * std::pow(t, 0.8));
    map[i] = from_oklab(lightness, chroma * std::cos(hue), chroma * std::sin(hue));
  }
  return map;
}

// Fills a picture pixel by pixel and fades it to the background where coverage is less than one.
template <typename Colour>
Image8 paint(const Planes& planes, const PlaneView& view, Colour&& colour) {
  Image8 image(planes.width, planes.height, 3);
  for (size_t i = 0; i < planes.pixels(); ++i) {
    const Rgb8 rgb = colour(i);
    const float alpha = view.coverage != nullptr ? std::clamp(view.coverage[i], 0.0f, 1.0f) : 1.0f;
    for (size_t c = 0; c < 3; ++c) {
      const auto back = static_cast<float>(view.background[c]);
      image.data[3 * i + c] =
          static_cast<uint8_t>(std::lround(back + alpha * (static_cast<float>(rgb[c]) - back)));
    }
  }
  return image;
}

uint8_t byte_from_unit(float value) {
  // Not a number becomes 0.
  return static_cast<uint8_t>(value > 0.0f ? std::lround(255.0f * std::min(value, 1.0f)) : 0);
}

void check_planes(const Planes& planes, int first, int count) {
  EFFIGY_CHECK(first >= 0 && first + count <= planes.count);
}

}  // namespace

Rgb8 map_colour(double t, ColourMap map) {
  const double clamped = t > 0.0 ? std::min(t, 1.0) : 0.0;
  const auto index = static_cast<size_t>(std::lround(clamped * 255.0));
  if (map == ColourMap::kGrey) {
    const auto grey = static_cast<uint8_t>(index);
    return {grey, grey, grey};
  }
  static const std::array<Rgb8, 256> perceptual = make_perceptual_map();
  return perceptual[index];
}

Image8 colour_normals(const Planes& planes, int first, const PlaneView& view) {
  check_planes(planes, first, 3);
  return paint(planes, view, [&](size_t i) {
    Rgb8 rgb{};
    for (int c = 0; c < 3; ++c)
      rgb[static_cast<size_t>(c)] = byte_from_unit(0.5f * (planes.plane(first + c)[i] + 1.0f));
    return rgb;
  });
}

Image8 colour_scalar(const Planes& planes, int plane, ColourMap map, double low, double high,
                     bool reverse, const PlaneView& view) {
  check_planes(planes, plane, 1);
  const float* values = planes.plane(plane);
  if (low == high) {
    std::vector<float> covered;
    for (size_t i = 0; i < planes.pixels(); ++i)
      if (std::isfinite(values[i]) && (view.coverage == nullptr || view.coverage[i] > 0.5f))
        covered.push_back(values[i]);
    if (!covered.empty()) {
      const auto at = [&](double share) {
        const auto nth = covered.begin() + static_cast<std::ptrdiff_t>(
                                               share * static_cast<double>(covered.size() - 1));
        std::nth_element(covered.begin(), nth, covered.end());
        return static_cast<double>(*nth);
      };
      low = at(0.02);
      high = at(0.98);
    }
    if (low == high) high = low + 1.0;
  }
  return paint(planes, view, [&](size_t i) {
    const double t = (static_cast<double>(values[i]) - low) / (high - low);
    return map_colour(reverse ? 1.0 - t : t, map);
  });
}

Image8 colour_uv(const Planes& planes, int first, int cells, const PlaneView& view) {
  check_planes(planes, first, 2);
  const auto count = static_cast<float>(cells);
  return paint(planes, view, [&](size_t i) {
    const float u = planes.plane(first)[i], v = planes.plane(first + 1)[i];
    if (!std::isfinite(u) || !std::isfinite(v)) return Rgb8{0, 0, 0};
    const bool odd = (static_cast<int>(std::floor(std::fmod(u, 2.0f) * count)) +
                      static_cast<int>(std::floor(std::fmod(v, 2.0f) * count))) &
                     1;
    return Rgb8{byte_from_unit(u), byte_from_unit(v), odd ? uint8_t{150} : uint8_t{70}};
  });
}

Image8 colour_rgb(const Planes& planes, int first, const PlaneView& view) {
  check_planes(planes, first, 3);
  return paint(planes, view, [&](size_t i) {
    return Rgb8{byte_from_unit(planes.plane(first)[i]), byte_from_unit(planes.plane(first + 1)[i]),
                byte_from_unit(planes.plane(first + 2)[i])};
  });
}

Image8 colour_difference(const Image8& a, const Image8& b, double full) {
  EFFIGY_CHECK_EQ(a.width, b.width);
  EFFIGY_CHECK_EQ(a.height, b.height);
  EFFIGY_CHECK_EQ(a.channels, b.channels);
  EFFIGY_CHECK(full > 0.0);
  Image8 image(a.width, a.height, 3);
  const auto channels = static_cast<size_t>(a.channels);
  const size_t used = std::min<size_t>(channels, 3);
  for (size_t i = 0; i < image.data.size() / 3; ++i) {
    int sum = 0;
    for (size_t c = 0; c < used; ++c)
      sum += std::abs(int{a.data[i * channels + c]} - int{b.data[i * channels + c]});
    const Rgb8 rgb =
        map_colour(sum / (255.0 * static_cast<double>(used) * full), ColourMap::kPerceptual);
    for (size_t c = 0; c < 3; ++c) image.data[3 * i + c] = rgb[c];
  }
  return image;
}

}  // namespace effigy
