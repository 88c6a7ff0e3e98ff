#include "effigy/body/draw.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/body/harmonics.h"
#include "effigy/body/pbr.h"
#include "effigy/body/stretches.h"

namespace effigy {
namespace {

constexpr float kLeastAlpha = 1.0f / 255.0f;  // of a pixel that gets specular light
constexpr float kLeastNormal = 1e-6f;         // length of a blended normal that means something
constexpr float kNarrowest = 1e-3f;           // lobe
constexpr size_t kGrain = 2048;

void zero(std::vector<float>& values, size_t count) {
  values.assign(count, 0.0f);
}

}  // namespace

BodyAppearance body_appearance_named(const std::string& name) {
  if (name == "zonal") return BodyAppearance::kZonal;
  if (name == "sh") return BodyAppearance::kHarmonics;
  if (name == "sh_turned") return BodyAppearance::kTurnedHarmonics;
  if (name == "pbr") return BodyAppearance::kPbr;
  throw Error("'" + name + "' is no appearance of bodies; choose zonal, sh, sh_turned or pbr.");
}

size_t transfer_coefficients(BodyAppearance appearance) {
  const bool harmonics =
      appearance == BodyAppearance::kHarmonics || appearance == BodyAppearance::kTurnedHarmonics;
  return harmonics ? kHarmonicCoefficients : kZonalCoefficients;
}

void BodySurfaceGradients::clear(size_t count, size_t transfer, size_t shadows) {
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
  zero(shadow, shadows * count);
}

UvGaussianGradients BodySurfaceGradients::placed() const {
  return {center, rotation, scale, opacity, axes, zonal, normal};
}

// Specular light is found for elements: the drawn pixels, or all Gaussians. Planar arrays.
struct BodyPicture::State {
  Planes image, radiance;
  GaussianFrame frame;
  size_t groups = 1;  // of lights; what differs between them is one after the other
  bool deferred = true;
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
  // Of group g: its share of an array with so many numbers a group.
  static std::span<float> part(std::vector<float>& all, size_t g, size_t each) {
    return {all.data() + g * each, each};
  }
  // Channels that each group has for itself: diffuse, shadow and, when not deferred, specular.
  int own_channels() const { return deferred ? 4 : 7; }
  int channel_count() const;
  BodyGroupChannels channels_of(size_t g) const;
  void shade_diffuse_part(const BodySurface& surface, const BodyLight& light,
                          const BodyDrawOptions& options, size_t g);
  void shade_texels(const BodySurface& surface, const BodyLight& light,
                    const BodyDrawOptions& options);
  PbrView pbr_view() const;
  void fill_features(const Camera& camera, const BodySurface& surface);
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
  void transfer_backward(const BodySurface& surface, const BodyLight& light,
                         const BodyDrawOptions& options, size_t g, BodySurfaceGradients& gradients);
  GaussianView view(const BodySurface& surface) const;
};

namespace {

// 1 / alpha, or 1 where the paper's products are wanted.
float over_alpha(float alpha, const BodyDrawOptions& options) {
  return options.divide_by_alpha ? 1.0f / std::max(alpha, kLeastAlpha) : 1.0f;
}

}  // namespace

int BodyPicture::State::channel_count() const {
  constexpr int kShared = kBodyChannels - 4;  // normal, roughness, visibility, depth
  return kShared + own_channels() * static_cast<int>(groups);
}

BodyGroupChannels BodyPicture::State::channels_of(size_t g) const {
  if (g == 0) return {};
  const int first = channel_count() - own_channels() * static_cast<int>(groups - g);
  return {first, first + 3, first + 4};
}

GaussianView BodyPicture::State::view(const BodySurface& surface) const {
  const UvGaussians& g = surface.placed;
  return {g.center, g.rotation, g.scale, g.opacity, features, channel_count()};
}

PbrView BodyPicture::State::pbr_view() const {
  return {elements(), normal, to_camera, where, blended, opaque, sigma};
}

// What a group of lights gives every texel, without its albedo.
void BodyPicture::State::shade_diffuse_part(const BodySurface& surface, const BodyLight& light,
                                            const BodyDrawOptions& options, size_t g) {
  const size_t n = surface.count();
  const std::span<float> given = part(diffuse_light, g, 3 * n);
  if (options.appearance == BodyAppearance::kZonal) {
    shade_diffuse({light.points, light.sh, light.bands.get()},
                  {n, surface.placed.axes, position, surface.placed.zonal}, given);
  } else if (options.appearance == BodyAppearance::kHarmonics) {
    const std::vector<float> own =
        root_harmonics(light.lamps(), surface.world_from_root, surface.root);
    std::copy(own.begin(), own.end(), part(harmonics, g, own.size()).begin());
    shade_harmonics(own, n, surface.placed.zonal, given);
  } else if (options.appearance == BodyAppearance::kTurnedHarmonics) {
    shade_turned_harmonics(light.sh.empty() ? light.points : sh_lamps(light.sh),
                           {n, surface.placed.axes, position, surface.placed.zonal}, given);
  } else {
    std::fill(given.begin(), given.end(), 1.0f);
  }
}

void BodyPicture::State::shade_texels(const BodySurface& surface, const BodyLight& light,
                                      const BodyDrawOptions& options) {
  const size_t n = surface.count();
  position.resize(3 * n);
  diffuse_light.resize(groups * 3 * n);
  diffuse.assign(3 * n, 0.0f);
  harmonics.resize(groups * 3 * kHarmonics);
  parallel_for(n, kGrain, [&](size_t begin, size_t end, int) {
    for (size_t c = 0; c < 3; ++c)
      for (size_t i = begin; i < end; ++i) position[c * n + i] = surface.placed.center[3 * i + c];
  });
  for (size_t g = 0; g < groups; ++g) shade_diffuse_part(surface, light.parts()[g], options, g);
  for (size_t g = 0; g < groups; ++g)
    parallel_for(n, kGrain, [&](size_t begin, size_t end, int) {
      for (size_t c = 0; c < 3; ++c)
        for (size_t i = begin; i < end; ++i)
          diffuse[c * n + i] += diffuse_light[(3 * g + c) * n + i] * surface.albedo[3 * i + c];
    });
}

void BodyPicture::State::fill_features(const Camera& camera, const BodySurface& surface) {
  const size_t n = surface.count(), channels = static_cast<size_t>(channel_count());
  features.resize(n * channels);
  const Eigen::Vector3f forward =
      camera.camera_from_world_rotation.row(2).transpose().cast<float>();
  const auto offset = static_cast<float>(camera.camera_from_world_translation.z());
  parallel_for(n, kGrain, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i) {
      float* f = &features[i * channels];
      for (size_t c = 0; c < 3; ++c) {
        f[kBodyNormal + c] = surface.placed.normal[c * n + i];
      }
      for (size_t g = 0; g < groups; ++g) {
        const BodyGroupChannels at = channels_of(g);
        for (size_t c = 0; c < 3; ++c) {
          f[static_cast<size_t>(at.diffuse) + c] =
              diffuse_light[(3 * g + c) * n + i] * surface.albedo[3 * i + c];
          if (!deferred)
            f[static_cast<size_t>(at.specular) + c] =
                specular[(3 * g + c) * n + i] * surface.visibility[i];
        }
        f[at.shadow] = surface.shadow.empty() ? 1.0f : surface.shadow[g * n + i];
      }
      f[kBodyRoughness] = surface.roughness[i];
      f[kBodyVisibility] = surface.visibility[i];
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
  for (auto* array : {&normal, &to_camera, &lobe, &where}) array->resize(3 * m);
  specular.resize(groups * 3 * m);
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
  for (auto* array : {&to_camera, &lobe}) array->resize(3 * n);
  specular.resize(groups * 3 * n);
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
    for (size_t g = 0; g < groups; ++g)
      shade_pbr(light.parts()[g].lamps(), pbr_view(), part(specular, g, 3 * m));
    return;
  }
  reflect_views(m, normal, to_camera, lobe);
  for (size_t g = 0; g < groups; ++g) {
    const BodyLight& own = light.parts()[g];
    shade_specular({own.points, own.lobes.get()}, options.sg_norm, {m, lobe, sigma, where},
                   part(specular, g, 3 * m));
  }
}

void BodyPicture::State::compose(const BodyDrawOptions& options) {
  if (radiance.width != image.width || radiance.height != image.height)
    radiance = Planes(image.width, image.height, 3);
  const size_t pixels = image.pixels(), m = pixel.size();
  const bool pbr = options.appearance == BodyAppearance::kPbr;
  const float* alpha = image.plane(0);
  std::fill(radiance.data.begin(), radiance.data.end(), 0.0f);
  for (size_t g = 0; g < groups && !pbr; ++g) {
    const BodyGroupChannels at = channels_of(g);
    const float* shadow = image.plane(1 + at.shadow);
    for_covered_stretches({alpha, pixels}, [&](size_t begin, size_t end) {
      for (int c = 0; c < 3; ++c) {
        const float* colour = image.plane(1 + at.diffuse + c);
        const float* gloss = deferred ? nullptr : image.plane(1 + at.specular + c);
        float* out = radiance.plane(c);
        for (size_t p = begin; p < end; ++p)
          out[p] += (colour[p] + (gloss != nullptr ? gloss[p] : 0.0f)) * shadow[p] *
                    over_alpha(alpha[p], options);
      }
    });
  }
  if (!deferred) return;
  const float* visible = image.plane(1 + kBodyVisibility);
  for (size_t g = 0; g < groups; ++g) {
    const float* shadow = image.plane(1 + channels_of(g).shadow);
    parallel_for(m, kGrain, [&](size_t begin, size_t end, int) {
      for (size_t e = begin; e < end; ++e) {
        const uint32_t p = pixel[e];
        const float weight = (pbr ? 1.0f : visible[p]) * shadow[p] * over_alpha(alpha[p], options);
        for (size_t c = 0; c < 3; ++c)
          radiance.plane(static_cast<int>(c))[p] += weight * specular[(3 * g + c) * m + e];
      }
    });
  }
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
  d_specular.assign(groups * 3 * m, 0.0f);
  std::vector<float>& d_shade = unused;  // derivative by h' of every pixel
  const float *alpha = image.plane(0), *visible = image.plane(1 + kBodyVisibility);
  const bool pbr = options.appearance == BodyAppearance::kPbr;
  if (!loss.alpha.empty()) std::copy(loss.alpha.begin(), loss.alpha.end(), d_image.plane(0));
  for (size_t g = 0; g < groups; ++g) {
    const BodyGroupChannels at = channels_of(g);
    const float* shadow = image.plane(1 + at.shadow);
    d_shade.assign(pixels, 0.0f);
    parallel_for(pbr ? 0 : pixels, kGrain, [&](size_t begin, size_t end, int) {
      for (int c = 0; c < 3; ++c) {
        const float* d = loss.radiance->plane(c);
        const float* colour = image.plane(1 + at.diffuse + c);
        const float* gloss = deferred ? nullptr : image.plane(1 + at.specular + c);
        for (size_t p = begin; p < end; ++p) {
          const float shade = shadow[p] * over_alpha(alpha[p], options);
          d_image.plane(1 + at.diffuse + c)[p] = d[p] * shade;
          if (gloss != nullptr) d_image.plane(1 + at.specular + c)[p] = d[p] * shade;
          d_shade[p] += d[p] * (colour[p] + (gloss != nullptr ? gloss[p] : 0.0f));
        }
      }
    });
    parallel_for(deferred ? m : 0, kGrain, [&](size_t begin, size_t end, int) {
      for (size_t e = begin; e < end; ++e) {
        const uint32_t p = pixel[e];
        const float shade = shadow[p] * over_alpha(alpha[p], options);
        float light = 0;
        for (size_t c = 0; c < 3; ++c) {
          const float d = loss.radiance->plane(static_cast<int>(c))[p];
          light += d * specular[(3 * g + c) * m + e];
          d_specular[(3 * g + c) * m + e] = d * shade * (pbr ? 1.0f : visible[p]);
        }
        if (!pbr) d_image.plane(1 + kBodyVisibility)[p] += light * shade;
        d_shade[p] += light * (pbr ? 1.0f : visible[p]);
      }
    });
    parallel_for(pixels, kGrain, [&](size_t begin, size_t end, int) {
      for (size_t p = begin; p < end; ++p) {
        const float inverse = over_alpha(alpha[p], options);
        d_image.plane(1 + at.shadow)[p] = d_shade[p] * inverse;
        if (options.divide_by_alpha && alpha[p] > kLeastAlpha)
          d_image.plane(0)[p] -= d_shade[p] * shadow[p] * inverse * inverse;
      }
    });
  }
}

void BodyPicture::State::lobes_backward(const BodyLight& light, const BodyDrawOptions& options) {
  const size_t m = elements();
  for (auto* array : {&d_lobe, &d_normal, &unused}) array->assign(3 * m, 0.0f);
  d_sigma.assign(m, 0.0f);
  if (options.appearance == BodyAppearance::kPbr) {
    d_blended.assign(3 * m, 0.0f);
    d_opaque.assign(m, 0.0f);
    for (size_t g = 0; g < groups; ++g)
      shade_pbr_backward(light.parts()[g].lamps(), pbr_view(), part(d_specular, g, 3 * m),
                         {d_normal, d_blended, d_opaque, d_sigma});
    return;
  }
  for (size_t g = 0; g < groups; ++g) {
    const BodyLight& own = light.parts()[g];
    shade_specular_backward({own.points, own.lobes.get()}, options.sg_norm, {m, lobe, sigma, where},
                            part(d_specular, g, 3 * m), {d_lobe, d_sigma, {}});
  }
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
  const size_t n = surface.count(), channels = static_cast<size_t>(channel_count());
  if (!deferred) {
    d_specular.assign(groups * 3 * n, 0.0f);
    for (size_t i = 0; i < n; ++i)
      for (size_t g = 0; g < groups; ++g)
        for (size_t c = 0; c < 3; ++c) {
          const float d =
              d_features[i * channels + static_cast<size_t>(channels_of(g).specular) + c];
          d_specular[(3 * g + c) * n + i] = d * surface.visibility[i];
          gradients.visibility[i] += d * specular[(3 * g + c) * n + i];
        }
    lobes_backward(light, options);
  }
  d_light.resize(groups * 3 * n);
  d_position.assign(3 * n, 0.0f);
  parallel_for(n, kGrain, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i) {
      const float* d = &d_features[i * channels];
      for (size_t g = 0; g < groups; ++g) {
        const BodyGroupChannels at = channels_of(g);
        for (size_t c = 0; c < 3; ++c) {
          const float colour = d[static_cast<size_t>(at.diffuse) + c] +
                               (loss.diffuse.empty() ? 0.0f : loss.diffuse[c * n + i]);
          d_light[(3 * g + c) * n + i] = colour * surface.albedo[3 * i + c];
          gradients.albedo[3 * i + c] += colour * diffuse_light[(3 * g + c) * n + i];
        }
        gradients.shadow[g * n + i] += d[at.shadow];
      }
      for (size_t c = 0; c < 3; ++c)
        gradients.normal[c * n + i] += d[kBodyNormal + c] + (deferred ? 0.0f : d_normal[c * n + i]);
      gradients.roughness[i] += d[kBodyRoughness];
      if (!deferred && surface.roughness[i] > kNarrowest) gradients.roughness[i] += d_sigma[i];
      gradients.visibility[i] += d[kBodyVisibility];
    }
  });
  for (size_t g = 0; g < groups; ++g)
    transfer_backward(surface, light.parts()[g], options, g, gradients);
  for (size_t i = 0; i < n; ++i)
    for (size_t c = 0; c < 3; ++c) gradients.center[3 * i + c] += d_position[c * n + i];
}

// From a group's light on every texel to the transfer and where it is.
void BodyPicture::State::transfer_backward(const BodySurface& surface, const BodyLight& light,
                                           const BodyDrawOptions& options, size_t g,
                                           BodySurfaceGradients& gradients) {
  const size_t n = surface.count();
  const std::span<const float> d_given = part(d_light, g, 3 * n);
  if (options.appearance == BodyAppearance::kHarmonics) {
    shade_harmonics_backward(part(harmonics, g, 3 * kHarmonics), n, d_given, gradients.zonal);
  } else if (options.appearance == BodyAppearance::kTurnedHarmonics) {
    shade_turned_harmonics_backward(light.sh.empty() ? light.points : sh_lamps(light.sh),
                                    {n, surface.placed.axes, position, surface.placed.zonal},
                                    d_given, {gradients.axes, d_position, gradients.zonal});
  } else if (options.appearance == BodyAppearance::kZonal) {
    shade_diffuse_backward({light.points, light.sh, light.bands.get()},
                           {n, surface.placed.axes, position, surface.placed.zonal}, d_given,
                           {gradients.axes, d_position, gradients.zonal, {}});
  }
}

BodyPicture::BodyPicture() : state_(std::make_unique<State>()) {}
BodyPicture::~BodyPicture() = default;
BodyPicture::BodyPicture(BodyPicture&&) noexcept = default;
BodyPicture& BodyPicture::operator=(BodyPicture&&) noexcept = default;

void BodyPicture::draw(const Camera& camera, const BodySurface& surface, const BodyLight& light,
                       const BodyDrawOptions& options) {
  State& s = *state_;
  EFFIGY_CHECK(options.deferred || options.appearance != BodyAppearance::kPbr);
  s.groups = light.parts().size();
  s.deferred = options.deferred;
  EFFIGY_CHECK(surface.shadow.empty() || surface.shadow.size() == s.groups * surface.count());
  s.shade_texels(surface, light, options);
  draw_again(camera, surface, light, options);
}

void BodyPicture::draw_again(const Camera& camera, const BodySurface& surface,
                             const BodyLight& light, const BodyDrawOptions& options) {
  State& s = *state_;
  EFFIGY_CHECK_EQ(s.position.size(), 3 * surface.count());
  if (!options.deferred) {
    s.gather_texels(camera, surface);
    s.shade_lobes(light, options);
  }
  s.fill_features(camera, surface);
  render_gaussians(camera, s.view(surface), options.raster, s.image, s.frame);
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
      camera, s.view(surface), options.raster, s.image, s.frame, s.d_image,
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
size_t BodyPicture::groups() const {
  return state_->groups;
}
BodyGroupChannels BodyPicture::channels_of(size_t group) const {
  return state_->channels_of(group);
}
std::span<const float> BodyPicture::diffuse() const {
  return state_->diffuse;
}
double BodyPicture::normal_orient() const {
  return state_->orient;
}

}  // namespace effigy
