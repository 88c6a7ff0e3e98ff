#include "effigy/body/renderer.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/body/losses.h"
#include "effigy/image/colour.h"
#include "effigy/light/light_groups.h"
#include "effigy/report/overlay.h"

namespace effigy {
namespace {

struct Buffer {
  const char* name;
  int first, count;
};
constexpr Buffer kBuffers[] = {{"normal", kBodyNormal, 3},
                               {"roughness", kBodyRoughness, 1},
                               {"visibility", kBodyVisibility, 1},
                               {"depth", kBodyDepth, 1}};

struct DiffusePlanes {
  Planes bare, shadowed, shadow;
};
// Diffuse light of all groups, without and with their shadows, and the shadow that they have
// together: each counts as much as it gives. Divided by alpha.
DiffusePlanes diffuse_planes(const BodyPicture& picture) {
  const Planes& channels = picture.channels();
  const int width = channels.width, height = channels.height;
  DiffusePlanes sum{Planes(width, height, 3), Planes(width, height, 3), Planes(width, height, 1)};
  std::vector<float> given(channels.pixels());
  for (size_t g = 0; g < picture.groups(); ++g) {
    const BodyGroupChannels at = picture.channels_of(g);
    for (size_t p = 0; p < channels.pixels(); ++p) {
      const float a = std::max(channels.plane(0)[p], 1e-3f);
      const float shadow = channels.plane(1 + at.shadow)[p] / a;
      float rgb[3];
      for (int c = 0; c < 3; ++c) {
        rgb[c] = channels.plane(1 + at.diffuse + c)[p] / a;
        sum.bare.plane(c)[p] += rgb[c];
        sum.shadowed.plane(c)[p] += rgb[c] * shadow;
      }
      // One group has its shadow also where it gives no light.
      const float weight =
          picture.groups() == 1 ? 1.0f : std::max(luminance(rgb[0], rgb[1], rgb[2]), 0.0f);
      sum.shadow.plane(0)[p] += weight * shadow;
      given[p] += weight;
    }
  }
  for (size_t p = 0; p < given.size(); ++p)
    sum.shadow.plane(0)[p] = given[p] > 0 ? sum.shadow.plane(0)[p] / given[p] : 0.0f;
  return sum;
}

// Planes of a buffer, divided by alpha.
Planes buffer_planes(const BodyPicture& picture, const std::string& name) {
  const Planes& channels = picture.channels();
  const float* alpha = channels.plane(0);
  if (name == "alpha") {
    Planes out(channels.width, channels.height, 1);
    std::copy_n(alpha, out.pixels(), out.plane(0));
    return out;
  }
  if (name == "diffuse" || name == "specular" || name == "shadow") {
    DiffusePlanes diffuse = diffuse_planes(picture);
    if (name == "diffuse") return std::move(diffuse.bare);
    if (name == "shadow") return std::move(diffuse.shadow);
    Planes out(channels.width, channels.height, 3);  // what is left without the diffuse part
    for (int c = 0; c < 3; ++c)
      for (size_t p = 0; p < out.pixels(); ++p)
        out.plane(c)[p] = picture.radiance().plane(c)[p] / std::max(alpha[p], 1e-3f) -
                          diffuse.shadowed.plane(c)[p];
    return out;
  }
  for (const Buffer& buffer : kBuffers) {
    if (name != buffer.name) continue;
    Planes out(channels.width, channels.height, buffer.count);
    for (int c = 0; c < buffer.count; ++c)
      for (size_t p = 0; p < out.pixels(); ++p)
        out.plane(c)[p] = channels.plane(1 + buffer.first + c)[p] / std::max(alpha[p], 1e-3f);
    return out;
  }
  throw Error("There is no buffer '" + name + "' of a body.");
}

}  // namespace

Planes body_albedo(const Camera& camera, const BodySurface& surface,
                   const GaussianRasterOptions& options) {
  const UvGaussians& g = surface.placed;
  GaussianFrame frame;
  Planes image;
  render_gaussians(camera, {g.center, g.rotation, g.scale, g.opacity, surface.albedo, 3}, options,
                   image, frame);
  Planes out(image.width, image.height, 3);
  for (int c = 0; c < 3; ++c)
    for (size_t p = 0; p < out.pixels(); ++p)
      out.plane(c)[p] = image.plane(1 + c)[p] / std::max(image.plane(0)[p], 1e-3f);
  return out;
}

const std::vector<std::string>& body_buffer_names() {
  static const std::vector<std::string> kNames = {"albedo", "diffuse",   "specular",
                                                  "normal", "roughness", "visibility",
                                                  "shadow", "depth",     "alpha"};
  return kNames;
}

Image body_buffer_values(const BodyPicture& picture, const std::string& name) {
  return to_image(buffer_planes(picture, name));
}

namespace {

Image8 encoded_colour(Planes planes, const PlaneView& view) {
  for (float& value : planes.data) value = srgb_from_linear(std::max(value, 0.0f));
  return colour_rgb(planes, 0, view);
}

}  // namespace

Image8 view_body_buffer(const BodyPicture& picture, const std::string& name) {
  const Planes planes = buffer_planes(picture, name);
  const PlaneView view{picture.channels().plane(0), {0, 0, 0}};
  if (name == "normal") return colour_normals(planes, 0, view);
  if (name == "depth") return colour_scalar(planes, 0, ColourMap::kPerceptual, 0, 0, true, view);
  if (planes.count == 1) return colour_scalar(planes, 0, ColourMap::kGrey, 0, 1, false, view);
  return encoded_colour(planes, view);
}

BodyBuffer BodyRenderer::buffer(const std::string& name, const Camera& camera) const {
  if (name != "albedo")
    return {body_buffer_values(picture_, name), view_body_buffer(picture_, name)};
  const Planes albedo = body_albedo(camera, avatar_.model.surface(), options_.raster);
  return {to_image(albedo), encoded_colour(albedo, {picture_.alpha().data(), {0, 0, 0}})};
}

BodyRenderer::BodyRenderer(BodyAvatar& avatar)
    : avatar_(avatar),
      options_(draw_options(avatar.settings)),
      samples_(avatar.settings.shadow_samples),
      irradiance_(avatar.model.shadow_texels()) {
  avatar_.model.networks().set_training(false);
  set_pose(RigPose::rest(avatar.rig));
}

void BodyRenderer::set_pose(const RigPose& pose) {
  moment_ = avatar_.driver.moment(pose);
  const std::vector<Vec3i>& triangles = avatar_.rig.mesh.triangles;
  std::vector<float> normals;
  // Neither can be split, but they can go side by side.
  run_slots(2, [&](int slot) {
    if (slot == 1)
      normals = vertex_normals(moment_.vertices, triangles);
    else if (rays_ != nullptr)
      rays_->move(moment_.vertices);
    else
      rays_ = std::make_unique<RayScene>(moment_.vertices, triangles, RayUse::kMoving);
  });
  avatar_.model.pose(moment_, normals);
  shadow_frames_ =
      texel_frames(avatar_.model.shadow_texels(), moment_.vertices, triangles, normals);
  changed_ = true;
  eye_.reset();
}

void BodyRenderer::set_points(PointLights points) {
  points_ = std::move(points);
  light_ = body_light(points_, groups());
  environment_.reset();
  parts_.clear();
  changed_ = true;
}

void BodyRenderer::set_environment(const Cubemap& radiance) {
  const bool table = avatar_.settings.environment_bands == "table";
  light_ = body_light(radiance, groups(), table);
  environment_.emplace(radiance, EnvironmentDraw::kLuminance);
  parts_.clear();
  if (groups() > 1)
    for (const Cubemap& part : group_environment(radiance, groups()))
      parts_.emplace_back(part, EnvironmentDraw::kLuminance);
  changed_ = true;
}

void BodyRenderer::find_shadow() {
  if (!avatar_.settings.shadow) return avatar_.model.light({});
  const IrradianceSampling sampling{samples_, avatar_.settings.seed};
  std::vector<float> pictures;
  const auto add = [&](const std::vector<float>& picture) {
    pictures.insert(pictures.end(), picture.begin(), picture.end());
  };
  if (!environment_)
    for (const BodyLight& part : light_.parts())
      add(irradiance_.of_points(shadow_frames_, *rays_, part.points, sampling));
  else if (parts_.empty())
    add(irradiance_.of_environment(shadow_frames_, *rays_, *environment_, sampling));
  for (const EnvironmentSampler& part : parts_)
    add(irradiance_.of_environment(shadow_frames_, *rays_, part, sampling));
  avatar_.model.light(pictures);
}

const Planes& BodyRenderer::draw(const Camera& camera, const std::array<float, 3>& background) {
  const bool changed = std::exchange(changed_, false);
  if (changed) find_shadow();
  const Vec3f eye = camera.center().cast<float>();
  if (eye != eye_) avatar_.model.look(eye);
  eye_ = eye;
  if (changed)
    picture_.draw(camera, avatar_.model.surface(), light_, options_);
  else
    picture_.draw_again(camera, avatar_.model.surface(), light_, options_);
  BodyTarget target;
  target.display = avatar_.display;
  const bool black = background[0] == 0 && background[1] == 0 && background[2] == 0;
  if (!black) {
    target.background = Planes(camera.width, camera.height, 3);
    for (int c = 0; c < 3; ++c)
      std::fill_n(target.background.plane(c), target.background.pixels(),
                  linear_from_srgb(background[static_cast<size_t>(c)]));
    if (ground_) {
      const Planes share = environment_ ? ground_shadow(camera, *ground_, *rays_, *environment_, {})
                                        : ground_shadow(camera, *ground_, *rays_, points_);
      for (size_t i = 0; i < share.data.size(); ++i) target.background.data[i] *= share.data[i];
    }
  }
  body_display(picture_, {}, target, display_);
  return display_;
}

}  // namespace effigy
