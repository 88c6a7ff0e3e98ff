#include "effigy/light/packed_environment.h"

#include <array>

#include "effigy/base/error.h"
#include "effigy/light/cubemap_layout.h"

namespace effigy {
namespace {

size_t padded_index(const PackedCubemap& map, int face, int x, int y) {
  const size_t n = static_cast<size_t>(map.size) + 2;
  return map.offset + (static_cast<size_t>(face) * n + static_cast<size_t>(y + 1)) * n +
         static_cast<size_t>(x + 1);
}

// Calls use(padded texel, source texel) for every texel beyond a face's edges; the source texel is
// affine in the position along an edge, so two lookups give all.
template <typename Use>
void for_edges(const PackedCubemap& map, const Use& use) {
  const int n = map.size;
  for (int face = 0; face < 6; ++face) {
    for (int edge = 0; edge < 4; ++edge) {
      const bool vertical = edge < 2;
      const int outside = edge % 2 ? n : -1;
      const auto source = [&](int i) {
        return static_cast<ptrdiff_t>(vertical ? cubemap_texel_across(face, outside, i, n)
                                               : cubemap_texel_across(face, i, outside, n));
      };
      const ptrdiff_t first = source(0), step = n > 1 ? source(1) - first : 0;
      for (int i = 0; i < n; ++i)
        use(vertical ? padded_index(map, face, outside, i) : padded_index(map, face, i, outside),
            static_cast<size_t>(first + step * i));
    }
  }
}

// Calls use(padded texel, three source texels) for every corner.
template <typename Use>
void for_corners(const PackedCubemap& map, const Use& use) {
  for (int face = 0; face < 6; ++face) {
    for (int corner = 0; corner < 4; ++corner) {
      const bool right = corner % 2, bottom = corner / 2;
      std::array<size_t, 3> source;
      cubemap_corner_texels(face, right, bottom, map.size, source.data());
      use(padded_index(map, face, right ? map.size : -1, bottom ? map.size : -1), source);
    }
  }
}

void pack(const Cubemap& cubemap, const PackedCubemap& map, float* texels) {
  const int n = map.size;
  const float* source = cubemap.texels.data();
  for (int face = 0; face < 6; ++face) {
    for (int y = 0; y < n; ++y) {
      float* out = texels + 4 * padded_index(map, face, 0, y);
      for (int x = 0; x < n; ++x, out += 4, source += 3) {
        out[0] = source[0];
        out[1] = source[1];
        out[2] = source[2];
      }
    }
  }
  source = cubemap.texels.data();
  for_edges(map, [&](size_t to, size_t from) {
    for (size_t c = 0; c < 3; ++c) texels[4 * to + c] = source[3 * from + c];
  });
  for_corners(map, [&](size_t to, const std::array<size_t, 3>& from) {
    for (size_t c = 0; c < 3; ++c)
      texels[4 * to + c] =
          (source[3 * from[0] + c] + source[3 * from[1] + c] + source[3 * from[2] + c]) / 3.0f;
  });
}

void unpack_gradient(const PackedCubemap& map, const float* d_texels, Cubemap& d_cubemap) {
  EFFIGY_CHECK_EQ(d_cubemap.size, map.size);
  const int n = map.size;
  float* out = d_cubemap.texels.data();
  for (int face = 0; face < 6; ++face) {
    for (int y = 0; y < n; ++y) {
      const float* in = d_texels + 4 * padded_index(map, face, 0, y);
      for (int x = 0; x < n; ++x, in += 4, out += 3) {
        out[0] += in[0];
        out[1] += in[1];
        out[2] += in[2];
      }
    }
  }
  out = d_cubemap.texels.data();
  for_edges(map, [&](size_t from, size_t to) {
    for (size_t c = 0; c < 3; ++c) out[3 * to + c] += d_texels[4 * from + c];
  });
  for_corners(map, [&](size_t from, const std::array<size_t, 3>& to) {
    for (const size_t texel : to)
      for (size_t c = 0; c < 3; ++c) out[3 * texel + c] += d_texels[4 * from + c] / 3.0f;
  });
}

}  // namespace

PackedEnvironment pack_environment(const PrefilteredEnvironment& light) {
  EFFIGY_CHECK(light.diffuse.size > 0 && !light.specular.empty());
  EFFIGY_CHECK_EQ(light.specular.size(), light.roughness.size());
  PackedEnvironment out;
  out.roughness = light.roughness;
  size_t texels = 0;
  const auto place = [&](const Cubemap& cubemap) {
    EFFIGY_CHECK_EQ(cubemap.texels.size(), static_cast<size_t>(18) * cubemap.size * cubemap.size);
    const PackedCubemap map{cubemap.size, texels};
    texels += map.texels();
    return map;
  };
  out.diffuse = place(light.diffuse);
  for (const Cubemap& level : light.specular) out.specular.push_back(place(level));
  out.texels.assign(4 * texels, 0.0f);
  pack(light.diffuse, out.diffuse, out.texels.data());
  for (size_t i = 0; i < light.specular.size(); ++i)
    pack(light.specular[i], out.specular[i], out.texels.data());
  return out;
}

void add_packed_gradient(const PackedEnvironment& pack, std::span<const float> d_texels,
                         PrefilteredEnvironment& d_light) {
  EFFIGY_CHECK_EQ(d_texels.size(), pack.texels.size());
  EFFIGY_CHECK_EQ(d_light.specular.size(), pack.specular.size());
  unpack_gradient(pack.diffuse, d_texels.data(), d_light.diffuse);
  for (size_t i = 0; i < pack.specular.size(); ++i)
    unpack_gradient(pack.specular[i], d_texels.data(), d_light.specular[i]);
}

}  // namespace effigy
