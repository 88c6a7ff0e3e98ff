#include "effigy/avatar/textures.h"

#include <cmath>

#include "effigy/image/colour.h"
#include "effigy/image/files.h"
#include "support.h"

namespace effigy {
namespace {

using test::contains;
using test::error_of;

MaterialTexture sample_texture(int size) {
  MaterialTexture texture(size, size);
  for (int y = 0; y < size; ++y)
    for (int x = 0; x < size; ++x) {
      float* t = &texture.texels[(static_cast<size_t>(y) * size + x) * 8];
      t[0] = static_cast<float>(x) / size;
      t[1] = static_cast<float>(y) / size;
      t[2] = 0.25f;
      t[3] = 0.5f;
      t[4] = 0.04f;
      t[5] = 0.3f * std::sin(0.4f * static_cast<float>(x));
      t[6] = 0.2f;
    }
  return texture;
}

TEST(Textures, PngsRoundTrip) {
  test::ScratchFolder scratch;
  const MaterialTexture texture = sample_texture(32);
  write_material(scratch.path(), texture);
  const MaterialTexture back = read_material(scratch.path());
  ASSERT_EQ(back.texels.size(), texture.texels.size());
  for (size_t i = 0; i < texture.texels.size(); ++i)
    EXPECT_NEAR(back.texels[i], texture.texels[i], 2e-4) << i;
}

TEST(Textures, RowZeroOfTheImageIsTheTopOfUv) {
  MaterialTexture texture(16, 16);
  texture.texels[(15 * 16) * 8 + 3] = 1.0f;  // v just under 1, u just over 0
  EXPECT_FLOAT_EQ(*to_images(texture).roughness.at(0, 0), 1.0f);
}

TEST(Textures, AlphaMasksAnEditAndRectanglesPlaceDecals) {
  test::ScratchFolder scratch;
  MaterialTexture texture = sample_texture(32);
  const MaterialTexture before = texture;
  Image8 decal(16, 16, 4);
  for (int y = 0; y < 16; ++y)
    for (int x = 0; x < 16; ++x) {
      decal.at(x, y)[0] = 255;
      decal.at(x, y)[3] = x < 8 ? 255 : 0;
    }
  write_png8(scratch / "albedo.png", decal);
  EXPECT_EQ(apply_edits(scratch.path(), {0.0, 0.5, 0.5, 1.0}, texture), 1);
  const auto texel = [](const MaterialTexture& t, int x, int y) {
    return &t.texels[(y * 32 + x) * 8];
  };
  EXPECT_NEAR(texel(texture, 2, 20)[0], 1.0f, 1e-4);  // inside, opaque
  EXPECT_NEAR(texel(texture, 2, 20)[1], 0.0f, 1e-4);
  EXPECT_NEAR(texel(texture, 12, 20)[0], texel(before, 12, 20)[0], 1e-4);  // transparent
  EXPECT_NEAR(texel(texture, 2, 4)[0], texel(before, 2, 4)[0], 1e-4);      // below the rectangle
  EXPECT_NEAR(texel(texture, 2, 20)[3], 0.5f, 1e-4);                       // other maps untouched
}

TEST(Textures, BadMapsAreNamed) {
  test::ScratchFolder scratch;
  MaterialTexture texture = sample_texture(32);
  EXPECT_TRUE(contains(error_of([&] {
                         apply_edits(scratch.path(), {0, 0, 1, 1}, texture);
                       }),
                       "no albedo.png"));
  write_png8(scratch / "albedo.png", Image8(20, 10, 3));
  EXPECT_TRUE(contains(error_of([&] {
                         apply_edits(scratch.path(), {0, 0, 1, 1}, texture);
                       }),
                       "20x10"));
  EXPECT_TRUE(contains(error_of([&] {
                         apply_edits(scratch.path(), {0.5, 0, 0.2, 1}, texture);
                       }),
                       "--rect"));
}

TEST(Textures, MapsOfDifferentSizesAreResampled) {
  test::ScratchFolder scratch;
  write_material(scratch.path(), sample_texture(64));
  write_png16(scratch / "roughness.png", Image(16, 16, 1, 0.75f));
  const MaterialTexture texture = read_material(scratch.path());
  EXPECT_EQ(texture.width, 64);
  EXPECT_NEAR(texture.texels[8 * 100 + 3], 0.75f, 1e-4);
}

}  // namespace
}  // namespace effigy
