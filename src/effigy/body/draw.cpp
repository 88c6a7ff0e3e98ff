#include "effigy/body/draw.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/body/pbr.h"
#include "effigy/light/spherical_harmonics.h"

namespace effigy {
namespace {

constexpr float kLeastAlpha = 1.0f / 255.0f;  // of a pixel that gets specular light
constexpr float kLeastNormal = 1e-6f;         // length of a blended normal that means something
constexpr float kNarrowest = 1e-3f;           // lobe
constexpr size_t kGrain = 2048;

constexpr int kDirectionsSize = 8;  // of the cubemap that stands for far lamps
constexpr size_t kHarmonics = sh_count(kZonalOrder), kColouredHarmonics = 16;
constexpr size_t kHarmonicCoefficients = 3 * kColouredHarmonics + kHarmonics - kColouredHarmonics;

// Where coefficient i of channel c is: the coloured ones first.
constexpr size_t harmonic_index(size_t i, size_t c) {
  return i < kColouredHarmonics ? 3 * i + c : 2 * kColouredHarmonics + i;
}

// Radiance times solid angle is kept.
Cubemap halved_to(Cubemap map, int size) {
  while (map.size > size && map.size % 2 == 0) {
    Cubemap half(map.size / 2);
    for (int face = 0; face < 6; ++face)
      for (int y = 0; y < half.size; ++y)
        for (int x = 0; x < half.size; ++x) {
          float* out = half.texels.data() + 3 * ((face * half.size + y) * half.size + x);
          double whole = 0, sum[3] = {};
          for (int k = 0; k < 4; ++k) {
            const int fx = 2 * x + k % 2, fy = 2 * y + k / 2;
            const double angle = cubemap_solid_angle(fx, fy, map.size);
            const float* in = map.texels.data() + 3 * ((face * map.size + fy) * map.size + fx);
            whole += angle;
            for (int c = 0; c < 3; ++c) sum[c] += angle * static_cast<double>(in[c]);
          }
          for (int c = 0; c < 3; ++c) out[c] = static_cast<float>(sum[c] / whole);
        }
    map = std::move(half);
  }
  return map;
}

// Spherical harmonics of the lamps in the root's frame, r g b of each coefficient.
std::vector<float> root_harmonics(const BodySurface& surface, const BodyLight& light) {
  PointLights turned = light.lamps();
  for (PointLight& lamp : turned.lights)
    lamp.position = surface.world_from_root.transpose() *
                    (lamp.directional ? lamp.position : Vec3f(lamp.position - surface.root));
  turned.center = surface.world_from_root.transpose() * (turned.center - surface.root);
  return sh_of_points(turned, Vec3f::Zero());
}

void zero(std::vector<float>& values, size_t count) {
  values.assign(count, 0.0f);
}

}  // namespace

BodyLight body_light(PointLights points) {
  BodyLight light;
  light.points = std::move(points);
  return light;
}

BodyLight body_light(const Cubemap& radiance) {
  BodyLight light;
  light.sh = sh_of_cubemap(radiance);
  light.lobes = std::make_shared<const LobeEnvironment>(radiance);
  const Cubemap coarse = halved_to(radiance, kDirectionsSize);
  for (int face = 0; face < 6; ++face)
    for (int y = 0; y < coarse.size; ++y)
      for (int x = 0; x < coarse.size; ++x) {
        const int i = 3 * ((face * coarse.size + y) * coarse.size + x);
        const Vec3f given = Vec3f(coarse.texels.data() + i) *
                            static_cast<float>(cubemap_solid_angle(x, y, coarse.size));
        light.directions.lights.push_back(
            {cubemap_direction(face, x, y, coarse.size), given, true});
      }
  return light;
}

BodyAppearance body_appearance_named(const std::string& name) {
  if (name == "zonal") return BodyAppearance::kZonal;
  if (name == "sh") return BodyAppearance::kHarmonics;
  if (name == "pbr") return BodyAppearance::kPbr;
  throw Error("'" + name + "' is no appearance of bodies; choose zonal, sh or pbr.");
}

size_t transfer_coefficients(BodyAppearance appearance) {
  return appearance == BodyAppearance::kHarmonics ? kHarmonicCoefficients : kZonalCoefficients;
}

void BodySurfaceGradients::clear(size_t count, size_t transfer) {
  zero(center, 3 * count);
  zero(rotation, 4 * count);
  zero(scale, 3 * count);
  zero(opacity, count);
  zero(axes, 9 * count);
  zero(zonal, transfer * count);
  zero(normal, 3 * count);
  zero(albedo, 3 * count);
  zero(roughness, count);
  zero(visibility, count);
  zero(shadow, count);
}

UvGaussianGradients BodySurfaceGradients::placed() const {
  return {center, rotation, scale, opacity, axes, zonal, normal};
}

// Specular light is found for elements: the drawn pixels, or all Gaussians. Planar arrays.
struct BodyPicture::State {
  Planes image, radiance;
  GaussianFrame frame;
  std::vector<float> features, position, diffuse_light, diffuse, harmonics;
  // Elements of specular light.
  std::vector<uint32_t> pixel;  // which; unused when not deferred
  std::vector<float> normal, inverse_length, to_camera, lobe, sigma, where, specular;
  std::vector<float> blended, opaque;  // albedo times alpha, alpha (kPbr)
  double orient = 0;
  // Backward.
  Planes d_image;
  std::vector<float> d_features, d_light, d_position, d_specular, d_lobe, d_sigma, d_normal, unused;
  std::vector<float> d_blended, d_opaque;

  size_t elements() const { return sigma.size(); }
  void shade_texels(const BodySurface& surface, const BodyLight& light,
                    const BodyDrawOptions& options);
  PbrView pbr_view() const;
  void fill_features(const Camera& camera, const BodySurface& surface,
                     const BodyDrawOptions& options);
  void gather_pixels(const Camera& camera, const BodyDrawOptions& options);
  void gather_texels(const Camera& camera, const BodySurface& surface);
  void shade_lobes(const BodyLight& light, const BodyDrawOptions& options);
  void compose(const BodyDrawOptions& options);

  void compose_backward(const BodyDrawOptions& options, const BodyPictureGradients& loss);
  void lobes_backward(const BodyLight& light, const BodyDrawOptions& options);
  void scatter_pixels(const BodyDrawOptions& options, float orient_weight);
  void texels_backward(const BodySurface& surface, const BodyLight& light,
                       const BodyDrawOptions& options, const BodyPictureGradients& loss,
                       BodySurfaceGradients& gradients);
  GaussianView view(const BodySurface& surface, const BodyDrawOptions& options) const;
};

namespace {

int channel_count(const BodyDrawOptions& options) {
  return options.deferred ? kBodyChannels : kBodyChannels + 3;
}

// 1 / alpha, or 1 where the paper's products are wanted.
float over_alpha(float alpha, const BodyDrawOptions& options) {
  return options.divide_by_alpha ? 1.0f / std::max(alpha, kLeastAlpha) : 1.0f;
}

}  // namespace

GaussianView BodyPicture::State::view(const BodySurface& surface,
                                      const BodyDrawOptions& options) const {
  const UvGaussians& g = surface.placed;
  return {g.center, g.rotation, g.scale, g.opacity, features, channel_count(options)};
}

PbrView BodyPicture::State::pbr_view() const {
  return {elements(), normal, to_camera, where, blended, opaque, sigma};
}

void BodyPicture::State::shade_texels(const BodySurface& surface, const BodyLight& light,
                                      const BodyDrawOptions& options) {
  const size_t n = surface.count();
  position.resize(3 * n);
  diffuse_light.resize(3 * n);
  diffuse.resize(3 * n);
  parallel_for(n, kGrain, [&](size_t begin, size_t end, int) {
    for (size_t c = 0; c < 3; ++c)
      for (size_t i = begin; i < end; ++i) position[c * n + i] = surface.placed.center[3 * i + c];
  });
  if (options.appearance == BodyAppearance::kZonal) {
    shade_diffuse({light.points, light.sh},
                  {n, surface.placed.axes, position, surface.placed.zonal}, diffuse_light);
  } else if (options.appearance == BodyAppearance::kHarmonics) {
    harmonics = root_harmonics(surface, light);
    parallel_for(n, kGrain, [&](size_t begin, size_t end, int) {
      for (size_t c = 0; c < 3; ++c) {
        std::fill_n(&diffuse_light[c * n + begin], end - begin, 0.0f);
        for (size_t k = 0; k < kHarmonics; ++k) {
          const float* d = &surface.placed.zonal[harmonic_index(k, c) * n];
          for (size_t i = begin; i < end; ++i)
            diffuse_light[c * n + i] += harmonics[3 * k + c] * d[i];
        }
      }
    });
  } else {
    std::fill(diffuse_light.begin(), diffuse_light.end(), 1.0f);
  }
  parallel_for(n, kGrain, [&](size_t begin, size_t end, int) {
    for (size_t c = 0; c < 3; ++c)
      for (size_t i = begin; i < end; ++i)
        diffuse[c * n + i] = diffuse_light[c * n + i] * surface.albedo[3 * i + c];
  });
}

void BodyPicture::State::fill_features(const Camera& camera, const BodySurface& surface,
                                       const BodyDrawOptions& options) {
  const size_t n = surface.count(), channels = static_cast<size_t>(channel_count(options));
  features.resize(n * channels);
  const Eigen::Vector3f forward =
      camera.camera_from_world_rotation.row(2).transpose().cast<float>();
  const auto offset = static_cast<float>(camera.camera_from_world_translation.z());
  parallel_for(n, kGrain, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i) {
      float* f = &features[i * channels];
      for (size_t c = 0; c < 3; ++c) {
        f[kBodyDiffuse + c] = diffuse[c * n + i];
        f[kBodyNormal + c] = surface.placed.normal[c * n + i];
        if (!options.deferred) f[kBodySpecular + c] = specular[c * n + i] * surface.visibility[i];
      }
      f[kBodyRoughness] = surface.roughness[i];
      f[kBodyVisibility] = surface.visibility[i];
      f[kBodyShadow] = surface.shadow.empty() ? 1.0f : surface.shadow[i];
      f[kBodyDepth] = forward.dot(Eigen::Map<const Vec3f>(&surface.placed.center[3 * i])) + offset;
    }
  });
}

void BodyPicture::State::gather_pixels(const Camera& camera, const BodyDrawOptions& options) {
  const float* alpha = image.plane(0);
  pixel.clear();
  for (size_t p = 0; p < image.pixels(); ++p)
    if (alpha[p] > kLeastAlpha) pixel.push_back(static_cast<uint32_t>(p));
  const size_t m = pixel.size();
  for (auto* array : {&normal, &to_camera, &lobe, &where, &specular}) array->resize(3 * m);
  sigma.resize(m);
  inverse_length.resize(m);
  const Eigen::Matrix3f world_from_camera =
      camera.camera_from_world_rotation.transpose().cast<float>();
  const Vec3f eye = camera.center().cast<float>();
  const auto width = static_cast<uint32_t>(image.width);
  parallel_for(m, kGrain, [&](size_t begin, size_t end, int) {
    for (size_t e = begin; e < end; ++e) {
      const uint32_t p = pixel[e], column = p % width, row = p / width;
      const double x = (column + 0.5 - camera.cx) / camera.fx;
      const double y = (row + 0.5 - camera.cy) / camera.fy;
      const Vec3f ray =
          world_from_camera * Vec3f(static_cast<float>(x), static_cast<float>(y), 1.0f);
      const float depth = image.plane(1 + kBodyDepth)[p] / alpha[p];
      const Vec3f w = -ray.normalized();
      Vec3f mean;
      for (int c = 0; c < 3; ++c) mean[c] = image.plane(1 + kBodyNormal + c)[p];
      const float length = mean.norm();
      const bool clear = length > kLeastNormal;
      inverse_length[e] = clear ? 1.0f / length : 0.0f;
      const Vec3f n = clear ? Vec3f(mean / length) : w;
      for (size_t c = 0; c < 3; ++c) {
        normal[c * m + e] = n[static_cast<int>(c)];
        to_camera[c * m + e] = w[static_cast<int>(c)];
        where[c * m + e] = eye[static_cast<int>(c)] + depth * ray[static_cast<int>(c)];
      }
      sigma[e] =
          std::max(image.plane(1 + kBodyRoughness)[p] * over_alpha(alpha[p], options), kNarrowest);
    }
  });
}

// Specular light of every Gaussian, for when it is splatted.
void BodyPicture::State::gather_texels(const Camera& camera, const BodySurface& surface) {
  const size_t n = surface.count();
  pixel.clear();
  for (auto* array : {&to_camera, &lobe, &specular}) array->resize(3 * n);
  normal = surface.placed.normal;
  where = position;
  sigma.resize(n);
  inverse_length.clear();
  const Vec3f eye = camera.center().cast<float>();
  parallel_for(n, kGrain, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i) {
      const Vec3f w = (eye - Eigen::Map<const Vec3f>(&surface.placed.center[3 * i])).normalized();
      for (size_t c = 0; c < 3; ++c) to_camera[c * n + i] = w[static_cast<int>(c)];
      sigma[i] = std::max(surface.roughness[i], kNarrowest);
    }
  });
}

void BodyPicture::State::shade_lobes(const BodyLight& light, const BodyDrawOptions& options) {
  const size_t m = elements();
  if (options.appearance == BodyAppearance::kPbr) {
    blended.resize(3 * m);
    opaque.resize(m);
    for (size_t e = 0; e < m; ++e) {
      opaque[e] = image.plane(0)[pixel[e]];
      for (size_t c = 0; c < 3; ++c)
        blended[c * m + e] = image.plane(1 + kBodyDiffuse + static_cast<int>(c))[pixel[e]];
    }
    return shade_pbr(light.lamps(), pbr_view(), specular);
  }
  reflect_views(m, normal, to_camera, lobe);
  shade_specular({light.points, light.lobes.get()}, options.sg_norm, {m, lobe, sigma, where},
                 specular);
}

void BodyPicture::State::compose(const BodyDrawOptions& options) {
  if (radiance.width != image.width || radiance.height != image.height)
    radiance = Planes(image.width, image.height, 3);
  const size_t pixels = image.pixels(), m = pixel.size();
  const bool pbr = options.appearance == BodyAppearance::kPbr;
  const float *alpha = image.plane(0), *shadow = image.plane(1 + kBodyShadow);
  parallel_for(pixels, kGrain, [&](size_t begin, size_t end, int) {
    for (int c = 0; c < 3; ++c) {
      const float* colour = image.plane(1 + kBodyDiffuse + c);
      const float* gloss = options.deferred ? nullptr : image.plane(1 + kBodySpecular + c);
      float* out = radiance.plane(c);
      for (size_t p = begin; p < end; ++p)
        out[p] = pbr ? 0.0f
                     : (colour[p] + (gloss != nullptr ? gloss[p] : 0.0f)) * shadow[p] *
                           over_alpha(alpha[p], options);
    }
  });
  if (!options.deferred) return;
  const float* visible = image.plane(1 + kBodyVisibility);
  parallel_for(m, kGrain, [&](size_t begin, size_t end, int) {
    for (size_t e = begin; e < end; ++e) {
      const uint32_t p = pixel[e];
      const float weight = (pbr ? 1.0f : visible[p]) * shadow[p] * over_alpha(alpha[p], options);
      for (size_t c = 0; c < 3; ++c)
        radiance.plane(static_cast<int>(c))[p] += weight * specular[c * m + e];
    }
  });
  double sum = 0;
  for (size_t e = 0; e < m; ++e) {
    const float facing = normal[e] * to_camera[e] + normal[m + e] * to_camera[m + e] +
                         normal[2 * m + e] * to_camera[2 * m + e];
    const double away = std::max(0.0f, -facing);
    sum += away * away;
  }
  orient = m > 0 ? sum / static_cast<double>(m) : 0.0;
}

// d_image and the derivative by the specular light of every element.
void BodyPicture::State::compose_backward(const BodyDrawOptions& options,
                                          const BodyPictureGradients& loss) {
  EFFIGY_CHECK(loss.radiance != nullptr && loss.radiance->count >= 3);
  const size_t pixels = image.pixels(), m = elements();
  if (d_image.width != image.width || d_image.height != image.height ||
      d_image.count != image.count)
    d_image = Planes(image.width, image.height, image.count);
  std::fill(d_image.data.begin(), d_image.data.end(), 0.0f);
  d_specular.assign(3 * m, 0.0f);
  std::vector<float>& d_shade = unused;  // derivative by h' of every pixel
  d_shade.assign(pixels, 0.0f);
  const float *alpha = image.plane(0), *shadow = image.plane(1 + kBodyShadow);
  const float* visible = image.plane(1 + kBodyVisibility);
  const bool pbr = options.appearance == BodyAppearance::kPbr;
  parallel_for(pbr ? 0 : pixels, kGrain, [&](size_t begin, size_t end, int) {
    for (int c = 0; c < 3; ++c) {
      const float* d = loss.radiance->plane(c);
      const float* colour = image.plane(1 + kBodyDiffuse + c);
      const float* gloss = options.deferred ? nullptr : image.plane(1 + kBodySpecular + c);
      for (size_t p = begin; p < end; ++p) {
        const float shade = shadow[p] * over_alpha(alpha[p], options);
        d_image.plane(1 + kBodyDiffuse + c)[p] = d[p] * shade;
        if (gloss != nullptr) d_image.plane(1 + kBodySpecular + c)[p] = d[p] * shade;
        d_shade[p] += d[p] * (colour[p] + (gloss != nullptr ? gloss[p] : 0.0f));
      }
    }
  });
  if (options.deferred)
    parallel_for(m, kGrain, [&](size_t begin, size_t end, int) {
      for (size_t e = begin; e < end; ++e) {
        const uint32_t p = pixel[e];
        const float shade = shadow[p] * over_alpha(alpha[p], options);
        float light = 0;
        for (size_t c = 0; c < 3; ++c) {
          const float d = loss.radiance->plane(static_cast<int>(c))[p];
          light += d * specular[c * m + e];
          d_specular[c * m + e] = d * shade * (pbr ? 1.0f : visible[p]);
        }
        if (!pbr) d_image.plane(1 + kBodyVisibility)[p] = light * shade;
        d_shade[p] += light * (pbr ? 1.0f : visible[p]);
      }
    });
  parallel_for(pixels, kGrain, [&](size_t begin, size_t end, int) {
    for (size_t p = begin; p < end; ++p) {
      const float inverse = over_alpha(alpha[p], options);
      d_image.plane(1 + kBodyShadow)[p] = d_shade[p] * inverse;
      float d_alpha = loss.alpha.empty() ? 0.0f : loss.alpha[p];
      if (options.divide_by_alpha && alpha[p] > kLeastAlpha)
        d_alpha -= d_shade[p] * shadow[p] * inverse * inverse;
      d_image.plane(0)[p] = d_alpha;
    }
  });
}

void BodyPicture::State::lobes_backward(const BodyLight& light, const BodyDrawOptions& options) {
  const size_t m = elements();
  for (auto* array : {&d_lobe, &d_normal, &unused}) array->assign(3 * m, 0.0f);
  d_sigma.assign(m, 0.0f);
  if (options.appearance == BodyAppearance::kPbr) {
    d_blended.assign(3 * m, 0.0f);
    d_opaque.assign(m, 0.0f);
    return shade_pbr_backward(light.lamps(), pbr_view(), d_specular,
                              {d_normal, d_blended, d_opaque, d_sigma});
  }
  shade_specular_backward({light.points, light.lobes.get()}, options.sg_norm,
                          {m, lobe, sigma, where}, d_specular, {d_lobe, d_sigma, {}});
  reflect_views_backward(m, normal, to_camera, d_lobe, d_normal, unused);
}

// What the pixels' normals and lobes mean for the blended channels.
void BodyPicture::State::scatter_pixels(const BodyDrawOptions& options, float orient_weight) {
  const size_t m = elements();
  const float each = m > 0 ? 2.0f * orient_weight / static_cast<float>(m) : 0.0f;
  const float* alpha = image.plane(0);
  parallel_for(m, kGrain, [&](size_t begin, size_t end, int) {
    for (size_t e = begin; e < end; ++e) {
      const uint32_t p = pixel[e];
      Vec3f n, w, d;
      for (size_t c = 0; c < 3; ++c) {
        const int k = static_cast<int>(c);
        n[k] = normal[c * m + e];
        w[k] = to_camera[c * m + e];
        d[k] = d_normal[c * m + e];
      }
      const float facing = n.dot(w);
      if (facing < 0) d += each * facing * w;
      const Vec3f mean = inverse_length[e] * (d - d.dot(n) * n);
      for (int c = 0; c < 3; ++c) d_image.plane(1 + kBodyNormal + c)[p] += mean[c];
      if (options.appearance == BodyAppearance::kPbr) {
        for (size_t c = 0; c < 3; ++c)
          d_image.plane(1 + kBodyDiffuse + static_cast<int>(c))[p] += d_blended[c * m + e];
        d_image.plane(0)[p] += d_opaque[e];
      }
      const float inverse = over_alpha(alpha[p], options);
      const float rough = image.plane(1 + kBodyRoughness)[p];
      if (rough * inverse <= kNarrowest) continue;
      d_image.plane(1 + kBodyRoughness)[p] += d_sigma[e] * inverse;
      if (options.divide_by_alpha) d_image.plane(0)[p] -= d_sigma[e] * rough * inverse * inverse;
    }
  });
}

// From the channels of every Gaussian to its parameters.
void BodyPicture::State::texels_backward(const BodySurface& surface, const BodyLight& light,
                                         const BodyDrawOptions& options,
                                         const BodyPictureGradients& loss,
                                         BodySurfaceGradients& gradients) {
  const size_t n = surface.count(), channels = static_cast<size_t>(channel_count(options));
  if (!options.deferred) {
    d_specular.assign(3 * n, 0.0f);
    for (size_t i = 0; i < n; ++i)
      for (size_t c = 0; c < 3; ++c) {
        const float d = d_features[i * channels + kBodySpecular + c];
        d_specular[c * n + i] = d * surface.visibility[i];
        gradients.visibility[i] += d * specular[c * n + i];
      }
    lobes_backward(light, options);
  }
  d_light.resize(3 * n);
  d_position.assign(3 * n, 0.0f);
  parallel_for(n, kGrain, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i) {
      const float* d = &d_features[i * channels];
      for (size_t c = 0; c < 3; ++c) {
        const float colour =
            d[kBodyDiffuse + c] + (loss.diffuse.empty() ? 0.0f : loss.diffuse[c * n + i]);
        d_light[c * n + i] = colour * surface.albedo[3 * i + c];
        gradients.albedo[3 * i + c] += colour * diffuse_light[c * n + i];
        gradients.normal[c * n + i] +=
            d[kBodyNormal + c] + (options.deferred ? 0.0f : d_normal[c * n + i]);
      }
      gradients.roughness[i] += d[kBodyRoughness];
      if (!options.deferred && surface.roughness[i] > kNarrowest)
        gradients.roughness[i] += d_sigma[i];
      gradients.visibility[i] += d[kBodyVisibility];
      gradients.shadow[i] += d[kBodyShadow];
    }
  });
  if (options.appearance == BodyAppearance::kPbr) return;
  if (options.appearance == BodyAppearance::kHarmonics) {
    parallel_for(n, kGrain, [&](size_t begin, size_t end, int) {
      for (size_t c = 0; c < 3; ++c)
        for (size_t k = 0; k < kHarmonics; ++k) {
          float* d = &gradients.zonal[harmonic_index(k, c) * n];
          for (size_t i = begin; i < end; ++i) d[i] += harmonics[3 * k + c] * d_light[c * n + i];
        }
    });
    return;
  }
  shade_diffuse_backward({light.points, light.sh},
                         {n, surface.placed.axes, position, surface.placed.zonal}, d_light,
                         {gradients.axes, d_position, gradients.zonal, {}});
  for (size_t i = 0; i < n; ++i)
    for (size_t c = 0; c < 3; ++c) gradients.center[3 * i + c] += d_position[c * n + i];
}

BodyPicture::BodyPicture() : state_(std::make_unique<State>()) {}
BodyPicture::~BodyPicture() = default;
BodyPicture::BodyPicture(BodyPicture&&) noexcept = default;
BodyPicture& BodyPicture::operator=(BodyPicture&&) noexcept = default;

void BodyPicture::draw(const Camera& camera, const BodySurface& surface, const BodyLight& light,
                       const BodyDrawOptions& options) {
  State& s = *state_;
  EFFIGY_CHECK(options.deferred || options.appearance != BodyAppearance::kPbr);
  s.shade_texels(surface, light, options);
  if (!options.deferred) {
    s.gather_texels(camera, surface);
    s.shade_lobes(light, options);
  }
  s.fill_features(camera, surface, options);
  render_gaussians(camera, s.view(surface, options), options.raster, s.image, s.frame);
  s.orient = 0;
  if (options.deferred) {
    s.gather_pixels(camera, options);
    s.shade_lobes(light, options);
  }
  s.compose(options);
}

void BodyPicture::backward(const Camera& camera, const BodySurface& surface, const BodyLight& light,
                           const BodyDrawOptions& options, const BodyPictureGradients& loss,
                           BodySurfaceGradients& gradients) {
  State& s = *state_;
  s.compose_backward(options, loss);
  if (options.deferred) {
    s.lobes_backward(light, options);
    s.scatter_pixels(options, loss.normal_orient);
  }
  s.d_features.assign(s.features.size(), 0.0f);
  render_gaussians_backward(
      camera, s.view(surface, options), options.raster, s.image, s.frame, s.d_image,
      {gradients.center, gradients.rotation, gradients.scale, gradients.opacity, s.d_features, {}});
  s.texels_backward(surface, light, options, loss, gradients);
}

const Planes& BodyPicture::radiance() const {
  return state_->radiance;
}
const Planes& BodyPicture::channels() const {
  return state_->image;
}
std::span<const float> BodyPicture::alpha() const {
  return {state_->image.plane(0), state_->image.pixels()};
}
std::span<const float> BodyPicture::diffuse() const {
  return state_->diffuse;
}
double BodyPicture::normal_orient() const {
  return state_->orient;
}

}  // namespace effigy
