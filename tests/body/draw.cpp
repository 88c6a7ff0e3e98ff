#include "effigy/body/draw.h"

#include <cmath>
#include <functional>
#include <set>
#include <string>

#include "effigy/base/random.h"
#include "effigy/base/threads.h"
#include "effigy/body/harmonics.h"
#include "effigy/light/builtin_lights.h"
#include "support.h"
#include "tiny_capture.h"

namespace effigy {
namespace {

Camera front_camera(int side) {
  return look_at(Vec3d(0.05, 0.02, 0.6), Vec3d::Zero(), 0.5, side, side);
}

PointLights two_lamps(float distance = 1.0f) {
  PointLights points;
  points.falloff = true;
  points.lights = {{distance * Vec3f(0.6f, 0.8f, 1.0f), Vec3f(2, 1.8f, 1.5f)},
                   {distance * Vec3f(-0.9f, 0.1f, 0.7f), Vec3f(0.6f, 0.8f, 1.2f)}};
  return points;
}

// A ball of Gaussians with random but sane parameters.
struct Ball {
  Mesh mesh = test::ball_rig().mesh;
  UvTexels texels;
  TexelFrames frames;
  BodySurface surface;

  explicit Ball(double spread = 0.15, int size = 24, size_t channels = GaussianChannels::kCount)
      : texels(uv_texels(mesh, size)), frames(texel_frames(texels, mesh.vertices, mesh.triangles)) {
    const size_t n = texels.count();
    Random random(5, 1);
    std::vector<float> decoded(n * channels);
    for (float& value : decoded) value = static_cast<float>(spread * random.normal());
    place_gaussians(texels, frames, decoded, surface.placed);
    const auto fill = [&](std::vector<float>& values, size_t count, double low, double high) {
      values.resize(count);
      for (float& value : values) value = static_cast<float>(low + (high - low) * random.uniform());
    };
    fill(surface.albedo, 3 * n, 0.3, 0.8);
    fill(surface.roughness, n, 0.15, 0.3);
    fill(surface.visibility, n, 0.2, 0.8);
    fill(surface.shadow, n, 0.4, 1.0);
  }
};

// A few Gaussians so large and thin that none is cut off anywhere in the picture: what is drawn has
// a derivative everywhere.
Ball fog(BodyAppearance appearance) {
  Ball ball(0.15, 6, 14 + transfer_coefficients(appearance));
  Random random(6, 1);
  for (float& scale : ball.surface.placed.scale)
    scale = static_cast<float>(0.2 + 0.1 * random.uniform());
  for (float& opacity : ball.surface.placed.opacity)
    opacity = static_cast<float>(0.1 + 0.2 * random.uniform());
  // Sharp highlights are beyond what differences of single precision can tell.
  if (appearance == BodyAppearance::kPbr)
    for (float& r : ball.surface.roughness) r = static_cast<float>(0.6 + 0.3 * random.uniform());
  return ball;
}

Cubemap gradient_sky() {
  Cubemap sky(16);
  for (int face = 0; face < 6; ++face)
    for (int y = 0; y < 16; ++y)
      for (int x = 0; x < 16; ++x) {
        const Vec3f d = cubemap_direction(face, x, y, 16);
        float* texel = &sky.texels[static_cast<size_t>(3 * ((face * 16 + y) * 16 + x))];
        texel[0] = 0.4f + 0.3f * d.y();
        texel[1] = 0.5f + 0.2f * d.x();
        texel[2] = 0.6f - 0.3f * d.z();
      }
  return sky;
}

// Sums of the picture's planes with weights that vary slowly over it.
struct SmoothLoss {
  Planes weight;
  std::vector<float> alpha, diffuse;
  float orient = 0;

  SmoothLoss(const Camera& camera, size_t texels, float orient_weight)
      : weight(camera.width, camera.height, 3), orient(orient_weight) {
    Random random(9, 2);
    alpha.resize(weight.pixels());
    for (size_t p = 0; p < weight.pixels(); ++p) {
      const float x = static_cast<float>(p % static_cast<size_t>(camera.width)) / 40.0f;
      const float y = static_cast<float>(p / static_cast<size_t>(camera.width)) / 40.0f;
      for (int c = 0; c < 3; ++c)
        weight.plane(c)[p] = 1 + 0.8f * std::sin(3 * x + 2 * y + static_cast<float>(c));
      alpha[p] = 0.5f + 0.5f * std::cos(2 * x - 3 * y);
    }
    diffuse.resize(3 * texels);
    for (float& w : diffuse) w = static_cast<float>(0.1 * random.normal());
  }
  double value(const BodyPicture& picture) const {
    double sum = static_cast<double>(orient) * picture.normal_orient();
    for (size_t i = 0; i < weight.data.size(); ++i)
      sum += static_cast<double>(weight.data[i]) * static_cast<double>(picture.radiance().data[i]);
    for (size_t i = 0; i < alpha.size(); ++i)
      sum += static_cast<double>(alpha[i]) * static_cast<double>(picture.alpha()[i]);
    for (size_t i = 0; i < diffuse.size(); ++i)
      sum += static_cast<double>(diffuse[i]) * static_cast<double>(picture.diffuse()[i]);
    return sum;
  }
  BodyPictureGradients gradients() const { return {&weight, alpha, diffuse, orient}; }
};

struct Group {
  const char* name;
  std::function<std::vector<float>&(BodySurface&)> values;
  std::function<std::vector<float>&(BodySurfaceGradients&)> gradient;
  double step;
};

std::vector<Group> groups() {
  using S = BodySurface;
  using G = BodySurfaceGradients;
  const auto placed = [](std::vector<float> UvGaussians::*array) {
    return [array](S& s) -> std::vector<float>& { return s.placed.*array; };
  };
  const auto own = [](std::vector<float> S::*array) {
    return [array](S& s) -> std::vector<float>& { return s.*array; };
  };
  const auto slope = [](std::vector<float> G::*array) {
    return [array](G& g) -> std::vector<float>& { return g.*array; };
  };
  return {{"center", placed(&UvGaussians::center), slope(&G::center), 1e-5},
          {"rotation", placed(&UvGaussians::rotation), slope(&G::rotation), 1e-3},
          {"scale", placed(&UvGaussians::scale), slope(&G::scale), 1e-3},
          {"opacity", placed(&UvGaussians::opacity), slope(&G::opacity), 1e-3},
          {"axes", placed(&UvGaussians::axes), slope(&G::axes), 1e-3},
          {"zonal", placed(&UvGaussians::zonal), slope(&G::zonal), 1e-2},
          {"normal", placed(&UvGaussians::normal), slope(&G::normal), 2e-3},
          {"albedo", own(&S::albedo), slope(&G::albedo), 1e-2},
          {"roughness", own(&S::roughness), slope(&G::roughness), 1e-3},
          {"visibility", own(&S::visibility), slope(&G::visibility), 1e-2},
          {"shadow", own(&S::shadow), slope(&G::shadow), 1e-2}};
}

// Normals stay unit: what changes their length is taken away (3 planes).
void keep_unit(const std::vector<float>& normal, std::vector<float>& direction) {
  const size_t n = normal.size() / 3;
  for (size_t i = 0; i < n; ++i) {
    float dot = 0;
    for (size_t c = 0; c < 3; ++c) dot += normal[c * n + i] * direction[c * n + i];
    for (size_t c = 0; c < 3; ++c) direction[c * n + i] -= dot * normal[c * n + i];
  }
}

std::vector<float> radiance_of(const Ball& ball, const BodyLight& light,
                               const BodyDrawOptions& options) {
  BodyPicture picture;
  picture.draw(front_camera(40), ball.surface, light, options);
  return picture.radiance().data;
}

// A shadow for each part of the light, the first as it was.
void shadow_parts(BodySurface& surface, size_t parts) {
  Random random(8, 4);
  const size_t n = surface.count();
  surface.shadow.resize(n * parts);
  for (size_t i = n; i < surface.shadow.size(); ++i)
    surface.shadow[i] = static_cast<float>(0.4 + 0.6 * random.uniform());
}

// Far enough for the pixels' depths, which have no gradient, not to matter.
constexpr float kFar = 300.0f;

// The derivative along random directions against central differences.
void check_gradients(const BodyLight& light, const BodyDrawOptions& options, float orient,
                     const std::set<std::string>& unused = {}) {
  Ball ball = fog(options.appearance);
  shadow_parts(ball.surface, light.parts().size());
  const Camera camera = front_camera(40);
  const SmoothLoss loss(camera, ball.texels.count(), orient);
  BodyPicture picture;
  picture.draw(camera, ball.surface, light, options);
  BodySurfaceGradients gradients;
  gradients.clear(ball.texels.count(), transfer_coefficients(options.appearance),
                  light.parts().size());
  picture.backward(camera, ball.surface, light, options, loss.gradients(), gradients);
  for (const Group& group : groups()) {
    if (unused.count(group.name) != 0) continue;
    // Where a Gaussian's own highlight is seen from moves with it; that is left out.
    if (!options.deferred && std::string(group.name) == "center") continue;
    Random random(31, 7);
    double worst = 0, typical = 0;
    for (int trial = 0; trial < 4; ++trial) {
      BodySurface moved = ball.surface;
      std::vector<float>& values = group.values(moved);
      const std::vector<float> start = values;
      std::vector<float> direction(values.size());
      double along = 0;
      for (float& d : direction) d = static_cast<float>(random.normal());
      if (std::string(group.name) == "normal") keep_unit(start, direction);
      for (size_t i = 0; i < values.size(); ++i) {
        along +=
            static_cast<double>(direction[i]) * static_cast<double>(group.gradient(gradients)[i]);
      }
      double ends[2];
      for (int side = 0; side < 2; ++side) {
        const double step = (side == 0 ? -1 : 1) * group.step;
        for (size_t i = 0; i < values.size(); ++i)
          values[i] = start[i] + static_cast<float>(step) * direction[i];
        BodyPicture other;
        other.draw(camera, moved, light, options);
        ends[side] = loss.value(other);
      }
      const double measured = (ends[1] - ends[0]) / (2 * group.step);
      worst = std::max(worst, std::abs(measured - along));
      typical += std::abs(measured) / 4;
    }
    EXPECT_GT(typical, 1e-5) << group.name;
    EXPECT_LT(worst, 0.02 * typical + 1e-3) << group.name << ", about " << typical;
  }
}

TEST(BodyDraw, GradientsUnderPoints) {
  check_gradients(body_light(two_lamps(kFar)), {}, 5.0f);
}

TEST(BodyDraw, GradientsUnderAnEnvironment) {
  check_gradients(body_light(gradient_sky()), {}, 0.0f);
}

TEST(BodyDraw, GradientsOfThePapersProducts) {
  BodyDrawOptions options;
  options.divide_by_alpha = false;
  check_gradients(body_light(two_lamps(kFar)), options, 0.0f);
}

TEST(BodyDraw, GradientsWithShadowsOfGroups) {
  check_gradients(body_light(two_lamps(kFar), 2), {}, 5.0f);
  BodyDrawOptions options;
  options.deferred = false;
  check_gradients(body_light(two_lamps(kFar), 2), options, 0.0f);
  options = {};
  options.appearance = BodyAppearance::kHarmonics;
  options.divide_by_alpha = false;
  check_gradients(body_light(two_lamps(kFar), 2), options, 0.0f, {"axes"});
  options = {};
  options.appearance = BodyAppearance::kPbr;
  check_gradients(body_light(two_lamps(kFar), 2), options, 1.0f, {"axes", "zonal", "visibility"});
}

TEST(BodyDraw, GradientsWithoutDeferredShading) {
  BodyDrawOptions options;
  options.deferred = false;
  check_gradients(body_light(two_lamps(kFar)), options, 0.0f);
}

TEST(BodyDraw, GradientsOfSphericalHarmonics) {
  BodyDrawOptions options;
  options.appearance = BodyAppearance::kHarmonics;
  check_gradients(body_light(two_lamps(kFar)), options, 0.0f, {"axes"});
}

TEST(BodyDraw, GradientsOfTurnedHarmonics) {
  BodyDrawOptions options;
  options.appearance = BodyAppearance::kTurnedHarmonics;
  // Of centres: the next test; here colours are so strong that differences of single precision
  // drown.
  check_gradients(body_light(two_lamps(kFar)), options, 0.0f, {"center"});
  check_gradients(body_light(gradient_sky()), options, 0.0f, {"center"});
}

// Where lamps are near, light changes with the place too.
TEST(BodyDraw, TurnedHarmonicsFollowTheLight) {
  const Ball ball(0.15, 12, 14 + kHarmonicCoefficients);
  const size_t n = ball.surface.count();
  const PointLights lamps = two_lamps();
  std::vector<float> position(3 * n), d_colour(3 * n, 1.0f), colour(3 * n);
  for (size_t i = 0; i < n; ++i)
    for (size_t c = 0; c < 3; ++c) position[c * n + i] = ball.surface.placed.center[3 * i + c];
  const UvGaussians& placed = ball.surface.placed;
  const auto sum = [&](const std::vector<float>& where) {
    shade_turned_harmonics(lamps, {n, placed.axes, where, placed.zonal}, colour);
    double total = 0;
    for (const float value : colour) total += static_cast<double>(value);
    return total;
  };
  std::vector<float> d_axes(9 * n), d_position(3 * n), d_transfer(placed.zonal.size());
  shade_turned_harmonics_backward(lamps, {n, placed.axes, position, placed.zonal}, d_colour,
                                  {d_axes, d_position, d_transfer});
  for (size_t c = 0; c < 3; ++c) {
    std::vector<float> up = position, down = position;
    double along = 0, size = 0;
    for (size_t i = 0; i < n; ++i) {
      up[c * n + i] += 1e-2f;
      down[c * n + i] -= 1e-2f;
      along += static_cast<double>(d_position[c * n + i]);
      size += std::abs(static_cast<double>(d_position[c * n + i]));
    }
    EXPECT_NEAR((sum(up) - sum(down)) / 2e-2, along, 2e-3 * size + 1e-3);
  }
}

// Lobes on the axes are some of all functions: with their harmonics the same picture.
TEST(BodyDraw, TurnedHarmonicsHoldTheLobes) {
  const Ball zonal;
  const size_t n = zonal.surface.count();
  Ball turned = zonal;
  turned.surface.placed.zonal.assign(kHarmonicCoefficients * n, 0.0f);
  for (size_t i = 0; i < n; ++i)
    for (size_t axis = 0; axis < 3; ++axis) {
      const double own[3] = {axis == 0 ? 1.0 : 0.0, axis == 1 ? 1.0 : 0.0, axis == 2 ? 1.0 : 0.0};
      for (size_t c = 0; c < 3; ++c) {
        double z[kZonalBands], sh[kHarmonics];
        for (size_t l = 0; l < kZonalBands; ++l)
          z[l] = static_cast<double>(zonal.surface.placed.zonal[zonal_index(axis, l, c) * n + i]);
        zonal_to_sh(z, own, sh);
        for (size_t k = 0; k < (c == 0 ? kHarmonics : kColouredHarmonics); ++k)
          turned.surface.placed.zonal[harmonic_index(k, c) * n + i] += static_cast<float>(sh[k]);
      }
    }
  BodyDrawOptions options;
  options.appearance = BodyAppearance::kTurnedHarmonics;
  for (const BodyLight& light : {body_light(two_lamps()), body_light(gradient_sky())}) {
    const std::vector<float> a = radiance_of(zonal, light, {});
    const std::vector<float> b = radiance_of(turned, light, options);
    for (size_t i = 0; i < a.size(); ++i) ASSERT_NEAR(a[i], b[i], 5e-5f);
  }
}

// A sun over a table of bands and over polynomials.
TEST(BodyDraw, BandTableIsTheSameLight) {
  const Ball ball;
  const Cubemap sky = cubemap_from_equirectangular(builtin_light("sunset"), 16);
  const std::vector<float> looked_up = radiance_of(ball, body_light(sky, 1, true), {});
  const std::vector<float> found = radiance_of(ball, body_light(sky), {});
  EXPECT_NE(looked_up, found);
  float most = 0;
  for (const float value : found) most = std::max(most, value);
  for (size_t i = 0; i < found.size(); ++i) ASSERT_NEAR(looked_up[i], found[i], 2e-3f * most);
}

TEST(BodyDraw, GradientsOfCookTorrance) {
  BodyDrawOptions options;
  options.appearance = BodyAppearance::kPbr;
  check_gradients(body_light(two_lamps(kFar)), options, 1.0f, {"axes", "zonal", "visibility"});
  check_gradients(body_light(gradient_sky()), options, 0.0f, {"axes", "zonal", "visibility"});
}

// Under even light a Lambertian body has one brightness for all appearances: albedo / pi times the
// irradiance, but for the highlights of Cook-Torrance.
TEST(BodyDraw, AppearancesAgreeUnderEvenLight) {
  Cubemap even(16, 1.0f);
  const BodyLight light = body_light(even);
  double sum = 0;
  for (const PointLight& lamp : light.directions.lights)
    sum += static_cast<double>(lamp.intensity.x());
  EXPECT_NEAR(sum, 4 * std::numbers::pi, 1e-3);
  Ball ball(0.0);
  std::fill(ball.surface.visibility.begin(), ball.surface.visibility.end(), 0.0f);
  std::fill(ball.surface.shadow.begin(), ball.surface.shadow.end(), 1.0f);
  std::fill(ball.surface.albedo.begin(), ball.surface.albedo.end(), 0.5f);
  const Camera camera = front_camera(32);
  BodyPicture zonal, pbr;
  zonal.draw(camera, ball.surface, light, {});
  BodyDrawOptions options;
  options.appearance = BodyAppearance::kPbr;
  std::fill(ball.surface.roughness.begin(), ball.surface.roughness.end(), 1.0f);
  pbr.draw(camera, ball.surface, light, options);
  const size_t middle = 16 * 32 + 16;
  const float a = zonal.alpha()[middle];
  ASSERT_GT(a, 0.5f);
  EXPECT_NEAR(zonal.radiance().plane(0)[middle] / a, 0.5f, 0.01f);
  EXPECT_NEAR(pbr.radiance().plane(0)[middle] / a, 0.5f, 0.05f);
  EXPECT_GT(pbr.radiance().plane(0)[middle] / a, 0.49f);
}

// A pixel of a solid ball against the formulas, in double precision and from scratch.
TEST(BodyDraw, PixelsAreAsTheFormulasSay) {
  Ball ball(0.0);
  const Camera camera = front_camera(48);
  BodyDrawOptions options;
  const BodyLight light = body_light(two_lamps());
  for (float& opacity : ball.surface.placed.opacity) opacity = 0.95f;
  BodyPicture picture;
  picture.draw(camera, ball.surface, light, options);
  const Planes& channels = picture.channels();
  int compared = 0;
  for (int y = 4; y < 44; y += 3)
    for (int x = 4; x < 44; x += 3) {
      const size_t p = static_cast<size_t>(y) * 48 + static_cast<size_t>(x);
      const double a = static_cast<double>(channels.plane(0)[p]);
      if (a < 0.9) continue;
      const auto of = [&](int c) { return static_cast<double>(channels.plane(1 + c)[p]); };
      const Vec3d n = Vec3d(of(kBodyNormal), of(kBodyNormal + 1), of(kBodyNormal + 2)).normalized();
      const Vec3d ray =
          camera.camera_from_world_rotation.transpose() *
          Vec3d((x + 0.5 - camera.cx) / camera.fx, (y + 0.5 - camera.cy) / camera.fy, 1.0);
      const Vec3d at = camera.center() + of(kBodyDepth) / a * ray, w = -ray.normalized();
      const Vec3d q = 2 * n.dot(w) * n - w;
      const double sigma = of(kBodyRoughness) / a;
      for (int c = 0; c < 3; ++c) {
        double gloss = 0;
        for (const PointLight& lamp : light.points.lights) {
          const Vec3d to = lamp.position.cast<double>() - at;
          const double theta = std::acos(std::clamp(q.dot(to.normalized()), -1.0, 1.0));
          const double strength = static_cast<double>(lamp.intensity[c]) *
                                  static_cast<double>(lamp.position.squaredNorm()) /
                                  to.squaredNorm();
          gloss += strength * std::exp(-0.5 * theta * theta / (sigma * sigma)) /
                   (std::sqrt(2.0) * std::pow(std::numbers::pi, 2.0 / 3) * sigma);
        }
        const double expected =
            (of(kBodyDiffuse + c) + of(kBodyVisibility) * gloss) * of(kBodyShadow) / a;
        EXPECT_NEAR(static_cast<double>(picture.radiance().plane(c)[p]), expected,
                    1e-4 * (1 + std::abs(expected)));
      }
      ++compared;
    }
  EXPECT_GT(compared, 20);
}

// Light is linear where nothing but light changes, and turning body, lights and camera together
// changes nothing.
TEST(BodyDraw, LightIsLinear) {
  const Ball ball;
  const Camera camera = front_camera(40);
  PointLights both = two_lamps(), one = both, other = both;
  one.lights.pop_back();
  other.lights.erase(other.lights.begin());
  BodyPicture sum, first, second;
  sum.draw(camera, ball.surface, body_light(both), {});
  first.draw(camera, ball.surface, body_light(one), {});
  second.draw(camera, ball.surface, body_light(other), {});
  for (size_t i = 0; i < sum.radiance().data.size(); ++i)
    ASSERT_NEAR(sum.radiance().data[i], first.radiance().data[i] + second.radiance().data[i],
                2e-5f);
}

// With a shadow for each group light adds up, whatever the shadows are; one group is what there was
// before, to the bit; and two that are shadowed alike are as one.
TEST(BodyDraw, ShadowsOfGroupsKeepLightLinear) {
  for (const BodyAppearance appearance :
       {BodyAppearance::kZonal, BodyAppearance::kHarmonics, BodyAppearance::kPbr})
    for (const bool deferred : {true, false}) {
      if (!deferred && appearance == BodyAppearance::kPbr) continue;
      BodyDrawOptions options;
      options.appearance = appearance;
      options.deferred = deferred;
      Ball both(0.15, 24, 14 + transfer_coefficients(appearance));
      const size_t n = both.surface.count();
      const PointLights lamps = two_lamps();
      BodyLight alone;
      alone.groups = {body_light(lamps)};
      EXPECT_EQ(radiance_of(both, alone, options), radiance_of(both, body_light(lamps), options));
      const BodyLight groups = body_light(lamps, 2);
      ASSERT_EQ(groups.parts().size(), 2u);
      const std::vector<float> whole = radiance_of(both, body_light(lamps), options);
      std::vector<float>& shadow = both.surface.shadow;
      const std::vector<float> alike(shadow.begin(), shadow.end());
      shadow.insert(shadow.end(), alike.begin(), alike.end());
      const std::vector<float> same = radiance_of(both, groups, options);
      for (size_t i = 0; i < same.size(); ++i) ASSERT_NEAR(same[i], whole[i], 2e-5f);

      shadow.resize(n);
      shadow_parts(both.surface, 2);
      std::vector<float> sum(same.size());
      for (size_t g = 0; g < 2; ++g) {
        Ball one = both;
        one.surface.shadow.assign(&shadow[g * n], &shadow[g * n] + n);
        const std::vector<float> part = radiance_of(one, groups.parts()[g], options);
        for (size_t i = 0; i < sum.size(); ++i) sum[i] += part[i];
      }
      const std::vector<float> drawn = radiance_of(both, groups, options);
      double moved = 0;
      for (size_t i = 0; i < sum.size(); ++i) {
        ASSERT_NEAR(drawn[i], sum[i], 2e-5f);
        moved = std::max(moved, static_cast<double>(std::abs(drawn[i] - whole[i])));
      }
      EXPECT_GT(moved, 0.01);
    }
}

TEST(BodyDraw, TurningEverythingChangesNothing) {
  Ball ball;
  const Mat3f turn = Eigen::AngleAxisf(0.8f, Vec3f(0.2f, 1, -0.3f).normalized()).toRotationMatrix();
  std::vector<float> vertices = ball.mesh.vertices;
  for (size_t v = 0; v + 2 < vertices.size(); v += 3)
    Eigen::Map<Vec3f>{&vertices[v]} = turn * Vec3f(&ball.mesh.vertices[v]);
  std::vector<float> decoded(ball.texels.count() * GaussianChannels::kCount);
  Random random(5, 1);
  for (float& value : decoded) value = static_cast<float>(0.15 * random.normal());
  BodySurface turned = ball.surface;
  place_gaussians(ball.texels, texel_frames(ball.texels, vertices, ball.mesh.triangles), decoded,
                  turned.placed);
  Camera camera = front_camera(40), turned_camera = camera;
  turned_camera.camera_from_world_rotation =
      camera.camera_from_world_rotation * turn.transpose().cast<double>();
  PointLights lamps = two_lamps();
  BodyPicture picture, other;
  picture.draw(camera, ball.surface, body_light(lamps), {});
  for (PointLight& lamp : lamps.lights) lamp.position = turn * lamp.position;
  other.draw(turned_camera, turned, body_light(lamps), {});
  double worst = 0;
  for (size_t i = 0; i < picture.radiance().data.size(); ++i)
    worst = std::max(worst, static_cast<double>(
                                std::abs(picture.radiance().data[i] - other.radiance().data[i])));
  EXPECT_LT(worst, 1e-3);
}

TEST(BodyDraw, SameBitsForEveryThreadCount) {
  const Ball ball;
  const Camera camera = front_camera(40);
  const BodyLight light = body_light(two_lamps());
  const SmoothLoss loss(camera, ball.texels.count(), 1.0f);
  const auto run = [&](int threads) {
    set_thread_count(threads);
    BodyPicture picture;
    picture.draw(camera, ball.surface, light, {});
    BodySurfaceGradients gradients;
    gradients.clear(ball.texels.count());
    picture.backward(camera, ball.surface, light, {}, loss.gradients(), gradients);
    return std::pair(picture.radiance().data, gradients.zonal);
  };
  const int before = thread_count();
  const auto one = run(1), three = run(3);
  set_thread_count(before);
  EXPECT_EQ(one.first, three.first);
  EXPECT_EQ(one.second, three.second);
}

// Another camera on the same surface in the same light.
TEST(BodyDraw, AgainIsAsIfFromTheBeginning) {
  Ball ball;
  const BodyLight light = body_light(two_lamps());
  const Camera side = look_at(Vec3d(0.5, 0.1, 0.3), Vec3d::Zero(), 0.5, 40, 40);
  for (const bool deferred : {true, false}) {
    BodyDrawOptions options;
    options.deferred = deferred;
    BodyPicture once, again;
    again.draw(front_camera(40), ball.surface, light, options);
    const std::vector<float> front = again.radiance().data;
    for (float& visible : ball.surface.visibility) visible *= 0.5f;
    again.draw_again(side, ball.surface, light, options);
    once.draw(side, ball.surface, light, options);
    EXPECT_EQ(again.radiance().data, once.radiance().data);
    EXPECT_EQ(again.channels().data, once.channels().data);
    EXPECT_NE(again.radiance().data, front);
  }
}

TEST(BodyDraw, NothingInView) {
  const Ball ball;
  Camera camera = look_at(Vec3d(0, 0, 3), Vec3d(0, 0, 9), 0.5, 24, 24);
  const SmoothLoss loss(camera, ball.texels.count(), 1.0f);
  BodyPicture picture;
  picture.draw(camera, ball.surface, body_light(two_lamps()), {});
  for (const float value : picture.radiance().data) ASSERT_EQ(value, 0.0f);
  BodySurfaceGradients gradients;
  gradients.clear(ball.texels.count());
  picture.backward(camera, ball.surface, body_light(two_lamps()), {}, loss.gradients(), gradients);
  for (const float value : gradients.center) ASSERT_TRUE(std::isfinite(value));
}

}  // namespace
}  // namespace effigy
