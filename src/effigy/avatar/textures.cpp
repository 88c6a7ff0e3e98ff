#include "effigy/avatar/textures.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/image/colour.h"
#include "effigy/image/files.h"
#include "effigy/image/resample.h"

namespace effigy {
namespace {

constexpr int kSmallest = 16, kLargest = 8192;

struct Map {
  const char* file;
  Image MaterialImages::*image;
  int channels;
};
constexpr Map kMaps[] = {{"albedo.png", &MaterialImages::albedo, 3},
                         {"roughness.png", &MaterialImages::roughness, 1},
                         {"specular.png", &MaterialImages::specular, 1},
                         {"normal.png", &MaterialImages::normal, 3}};

// `channels` channels of an image with 1, 3 or 4; grey is repeated, colour to grey takes red.
Image select_channels(const Image& image, int channels) {
  Image out(image.width, image.height, channels);
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x)
      for (int c = 0; c < channels; ++c)
        out.at(x, y)[c] = image.at(x, y)[image.channels >= 3 ? c : 0];
  return out;
}

Image alpha_of(const Image& image) {
  Image out(image.width, image.height, 1, 1.0f);
  if (image.channels != 4) return out;
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) *out.at(x, y) = image.at(x, y)[3];
  return out;
}

void check_map(const Image& image, const std::string& name) {
  if (image.width != image.height || image.width < kSmallest || image.width > kLargest)
    throw Error(name + ": a texture must be square, " + std::to_string(kSmallest) + " to " +
                std::to_string(kLargest) + " pixels, not " + std::to_string(image.width) + "x" +
                std::to_string(image.height) + "; resize it.");
}

// Texel values from the encoded maps at one place, all maps of one size.
void encode_texel(const MaterialImages& images, int x, int y, float* texel) {
  for (int c = 0; c < 3; ++c) texel[c] = linear_from_srgb(images.albedo.at(x, y)[c]);
  texel[3] = std::clamp(*images.roughness.at(x, y), 0.0f, 1.0f);
  texel[4] = std::clamp(*images.specular.at(x, y), 0.0f, 1.0f);
  const float* n = images.normal.at(x, y);
  float nx = 2 * n[0] - 1, ny = 2 * n[1] - 1;
  const float nz = std::max(2 * n[2] - 1, 0.0f);
  const float length = std::sqrt(nx * nx + ny * ny + nz * nz);
  if (length > 1e-4f) {
    nx /= length;
    ny /= length;
  } else {
    nx = ny = 0;
  }
  texel[5] = nx;
  texel[6] = ny;
  texel[7] = 0;
}

}  // namespace

MaterialImages to_images(const MaterialTexture& texture) {
  const int w = texture.width, h = texture.height;
  MaterialImages images{Image(w, h, 3), Image(w, h, 1), Image(w, h, 1), Image(w, h, 3)};
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x) {
      const float* texel = &texture.texels[(static_cast<size_t>(h - 1 - y) * w + x) * 8];
      for (int c = 0; c < 3; ++c) images.albedo.at(x, y)[c] = srgb_from_linear(texel[c]);
      *images.roughness.at(x, y) = texel[3];
      *images.specular.at(x, y) = texel[4];
      const float nz = std::sqrt(std::max(0.0f, 1 - texel[5] * texel[5] - texel[6] * texel[6]));
      images.normal.at(x, y)[0] = 0.5f * (texel[5] + 1);
      images.normal.at(x, y)[1] = 0.5f * (texel[6] + 1);
      images.normal.at(x, y)[2] = 0.5f * (nz + 1);
    }
  return images;
}

MaterialTexture to_texture(const MaterialImages& given, const std::string& name) {
  int size = 0;
  for (const Map& map : kMaps) {
    check_map(given.*map.image, name + "/" + map.file);
    size = std::max(size, (given.*map.image).width);
  }
  MaterialImages images;
  for (const Map& map : kMaps) {
    const Image& image = given.*map.image;
    images.*map.image = image.width == size ? image : resize(image, size, size);
  }
  MaterialTexture texture(size, size);
  for (int y = 0; y < size; ++y)
    for (int x = 0; x < size; ++x)
      encode_texel(images, x, y,
                   &texture.texels[(static_cast<size_t>(size - 1 - y) * size + x) * 8]);
  return texture;
}

void write_material(const Path& folder, const MaterialTexture& texture) {
  const MaterialImages images = to_images(texture);
  for (const Map& map : kMaps) write_png16(folder / map.file, images.*map.image);
}

MaterialTexture read_material(const Path& folder) {
  MaterialImages images;
  for (const Map& map : kMaps)
    images.*map.image = select_channels(read_image(folder / map.file), map.channels);
  return to_texture(images, folder.string());
}

MaterialImages read_maps(const Path& folder) {
  MaterialImages images;
  for (const Map& map : kMaps) {
    const Path path = folder / map.file;
    if (!std::filesystem::exists(path)) continue;
    images.*map.image = select_channels(read_image(path), map.channels);
    check_map(images.*map.image, path.string());
  }
  return images;
}

void write_maps(const Path& folder, const MaterialImages& images) {
  for (const Map& map : kMaps)
    if (!(images.*map.image).empty()) write_png16(folder / map.file, images.*map.image);
}

int apply_edits(const Path& folder, const UvRectangle& where, MaterialImages& images) {
  const auto [u0, v0, u1, v1] = where;
  if (!(u0 >= 0 && v0 >= 0 && u1 <= 1 && v1 <= 1 && u0 < u1 && v0 < v1))
    throw Error("--rect must be u0,v0,u1,v1 with 0 <= u0 < u1 <= 1 and 0 <= v0 < v1 <= 1.");
  const bool whole = u0 == 0 && v0 == 0 && u1 == 1 && v1 == 1;
  int applied = 0;
  for (const Map& map : kMaps) {
    const Path path = folder / map.file;
    Image& target = images.*map.image;
    if (!std::filesystem::exists(path) || target.empty()) continue;
    const int w = target.width, h = target.height;
    const int x0 = static_cast<int>(std::lround(u0 * w));
    const int x1 = static_cast<int>(std::lround(u1 * w));
    const int y0 = static_cast<int>(std::lround((1 - v1) * h));
    const int y1 = static_cast<int>(std::lround((1 - v0) * h));
    if (x1 <= x0 || y1 <= y0) throw Error("--rect covers no texel of the atlas; make it larger.");
    const Image read = read_image(path);
    if (whole) check_map(read, path.string());
    const Image edit = resize(select_channels(read, map.channels), x1 - x0, y1 - y0);
    const Image alpha = resize(alpha_of(read), x1 - x0, y1 - y0);
    for (int y = y0; y < y1; ++y)
      for (int x = x0; x < x1; ++x) {
        const float a = *alpha.at(x - x0, y - y0);
        for (int c = 0; c < map.channels; ++c)
          target.at(x, y)[c] += a * (edit.at(x - x0, y - y0)[c] - target.at(x, y)[c]);
      }
    ++applied;
  }
  if (applied == 0)
    throw Error(
        folder.string() +
        ": no albedo.png, roughness.png, specular.png or normal.png to apply; put the edited "
        "maps there under these names.");
  return applied;
}

int apply_edits(const Path& folder, const UvRectangle& where, MaterialTexture& texture) {
  MaterialImages images = to_images(texture);
  const int applied = apply_edits(folder, where, images);
  texture = to_texture(images, folder.string());
  return applied;
}

}  // namespace effigy
