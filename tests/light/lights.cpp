// Environment files and the built-in lights.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <limits>

#include "effigy/base/error.h"
#include "effigy/image/files.h"
#include "effigy/light/builtin_lights.h"
#include "effigy/light/environment.h"

namespace effigy {
namespace {

Path scratch(const std::string& name) {
  const Path folder = std::filesystem::temp_directory_path() / "effigy_test_light";
  std::filesystem::create_directories(folder);
  return folder / name;
}

TEST(BuiltinLights, HaveMeanRadianceOneAndRange) {
  ASSERT_EQ(builtin_light_names().size(), 4u);
  for (const std::string& name : builtin_light_names()) {
    const Image image = builtin_light(name);
    EXPECT_EQ(image.width, 256);
    EXPECT_EQ(image.height, 128);
    float low = 1e9f, high = 0;
    for (const float value : image.data) {
      ASSERT_TRUE(std::isfinite(value) && value > 0) << name;
      low = std::min(low, value);
      high = std::max(high, value);
    }
    EXPECT_NEAR(mean_radiance(cubemap_from_equirectangular(image, 32)), 1.0, 2e-3) << name;
    EXPECT_GT(high / low, name == "sunset" ? 1e4f : name == "studio" ? 100.0f : 3.0f) << name;
  }
  EXPECT_THROW(builtin_light("moon"), Error);
}

TEST(BuiltinLights, LightFromAboveMoreThanFromBelow) {
  for (const std::string& name : builtin_light_names()) {
    const PrefilteredEnvironment e = prefilter_environment(builtin_light(name));
    const Vec3f up = sample_cubemap(e.diffuse, {0, 1, 0}),
                down = sample_cubemap(e.diffuse, {0, -1, 0});
    EXPECT_GT(up.sum(), 1.5f * down.sum()) << name;
  }
}

TEST(ReadEnvironment, ReadsLinearAndEncodedFiles) {
  Image image(8, 4, 3, 0.25f);
  image.at(3, 1)[1] = 40.0f;
  write_exr(scratch("a.exr"), image);
  const Image exr = read_environment(scratch("a.exr"));
  EXPECT_FLOAT_EQ(exr.at(3, 1)[1], 40.0f);
  EXPECT_FLOAT_EQ(exr.at(0, 0)[0], 0.25f);
  write_png8(scratch("a.png"), Image8(8, 4, 3, 188));
  EXPECT_NEAR(read_environment(scratch("a.png")).at(2, 2)[2], 0.5029, 1e-3);  // sRGB 188/255
  write_png8(scratch("grey.png"), Image8(8, 4, 1, 255));
  EXPECT_NEAR(read_environment(scratch("grey.png")).at(2, 2)[2], 1.0, 1e-6);
}

TEST(ReadEnvironment, RejectsWhatIsNoLight) {
  const auto message = [](const Path& path) -> std::string {
    try {
      read_environment(path);
    } catch (const Error& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_NE(message(scratch("missing.exr")), "");
  write_exr(scratch("square.exr"), Image(8, 8, 3, 1.0f));
  EXPECT_NE(message(scratch("square.exr")).find("8 x 8"), std::string::npos);
  Image image(8, 4, 3, 1.0f);
  image.at(5, 2)[0] = std::numeric_limits<float>::quiet_NaN();
  write_exr(scratch("nan.exr"), image, false);
  EXPECT_NE(message(scratch("nan.exr")).find("(5, 2)"), std::string::npos)
      << message(scratch("nan.exr"));
  image.at(5, 2)[0] = std::numeric_limits<float>::infinity();
  write_exr(scratch("inf.exr"), image, false);
  EXPECT_NE(message(scratch("inf.exr")), "");
  image.at(5, 2)[0] = -1.0f;
  write_exr(scratch("negative.exr"), image, false);
  EXPECT_NE(message(scratch("negative.exr")).find("negative"), std::string::npos);
  image.at(5, 2)[0] = -1e-4f;  // compression noise is forgiven
  write_exr(scratch("ringing.exr"), image, false);
  EXPECT_EQ(read_environment(scratch("ringing.exr")).at(5, 2)[0], 0.0f);
  write_exr(scratch("black.exr"), Image(8, 4, 3, 0.0f));
  EXPECT_NE(message(scratch("black.exr")).find("black"), std::string::npos);
}

TEST(ReadEnvironment, RealHdrisKeepTheirFlux) {
  const char* data = std::getenv("EFFIGY_DATA");
  if (!data) GTEST_SKIP() << "EFFIGY_DATA is not set: no HDRIs to read.";
  int seen = 0;
  for (const char* name : {"venice_sunset_1k.hdr", "forest.exr", "studio_small_03_1k.hdr"}) {
    const Path path = Path(data) / "hdri" / name;
    if (!std::filesystem::exists(path)) continue;
    ++seen;
    const Image image = read_environment(path);
    double sum = 0;
    for (int y = 0; y < image.height; ++y) {
      const double w = std::cos(M_PI * y / image.height) - std::cos(M_PI * (y + 1) / image.height);
      for (int x = 0; x < image.width; ++x) {
        const float* p = image.at(x, y);
        sum += w / image.width / 2 * (0.2126 * p[0] + 0.7152 * p[1] + 0.0722 * p[2]);
      }
    }
    for (const int size : {32, 128})
      EXPECT_NEAR(mean_radiance(cubemap_from_equirectangular(image, size, 1.1)), sum, 1e-3 * sum)
          << name << " " << size;
  }
  if (!seen) GTEST_SKIP() << "No HDRIs in EFFIGY_DATA/hdri.";
}

}  // namespace
}  // namespace effigy
