#include "effigy/avatar/renderer.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"

namespace effigy {

HeadRenderer::HeadRenderer(const HeadAvatar& avatar)
    : avatar_(avatar),
      light_(pack_environment(Prefilter(avatar.environment.size).forward(avatar.environment))) {
  set_pose(RigPose::rest(avatar.rig));
}

void HeadRenderer::set_pose(const RigPose& pose) {
  pose_vertices(avatar_.shape, pose, vertices_);
  pose_surfels(avatar_.rig.mesh, vertices_, avatar_.surfels, avatar_.bind, posed_);
}

void HeadRenderer::set_exact(bool exact) {
  exact_ = exact;
  if (!exact) playback_material_ = PlaybackTexture(avatar_.material);
}

const Planes& HeadRenderer::draw(const Camera& camera, const std::array<float, 3>& background) {
  if (exact_) {
    render_surfels(camera, posed_, avatar_.material, {}, gbuffer_, frame_);
  } else {
    PlaybackOptions options;
    options.only_shading = true;
    render_surfels_playback(camera, posed_, playback_material_, options, gbuffer_, frame_);
  }
  ShadeOptions options;
  options.display = avatar_.display;
  options.background = background;
  shade_deferred(gbuffer_, camera, light_, options, colour_);
  return colour_;
}

namespace {

struct Buffer {
  const char* name;
  int plane, channels;
};
constexpr Buffer kBuffers[] = {{"albedo", kAlbedo, 3},
                               {"roughness", kRoughness, 1},
                               {"specular", kSpecular, 1},
                               {"normal", kNormal, 3},
                               {"mapped_normal", kMappedNormal, 3},
                               {"depth", kDepth, 1},
                               {"alpha", kAlpha, 1},
                               {"uv", kUv, 2}};

const Buffer& find_buffer(const std::string& name) {
  for (const Buffer& buffer : kBuffers)
    if (name == buffer.name) return buffer;
  throw Error("Unknown buffer '" + name +
              "'; known are albedo, roughness, specular, normal, mapped_normal, depth, alpha, uv.");
}

}  // namespace

const std::vector<std::string>& buffer_names() {
  static const std::vector<std::string> names = [] {
    std::vector<std::string> list;
    for (const Buffer& buffer : kBuffers) list.emplace_back(buffer.name);
    return list;
  }();
  return names;
}

Image buffer_values(const Planes& gbuffer, const std::string& name) {
  const Buffer& buffer = find_buffer(name);
  Image out(gbuffer.width, gbuffer.height, buffer.channels);
  const bool is_normal = buffer.plane == kNormal || buffer.plane == kMappedNormal;
  const float* alpha = gbuffer.plane(kAlpha);
  for (size_t i = 0; i < gbuffer.pixels(); ++i) {
    float* value = &out.data[i * buffer.channels];
    for (int c = 0; c < buffer.channels; ++c) {
      const float sum = gbuffer.plane(buffer.plane + c)[i];
      value[c] = buffer.plane == kAlpha ? sum : (alpha[i] > 1e-4f ? sum / alpha[i] : 0.0f);
    }
    if (is_normal) {
      const float length =
          std::sqrt(value[0] * value[0] + value[1] * value[1] + value[2] * value[2]);
      if (length > 1e-6f)
        for (int c = 0; c < 3; ++c) value[c] /= length;
    }
  }
  return out;
}

Image8 view_buffer(const Planes& gbuffer, const std::string& name) {
  const Buffer& buffer = find_buffer(name);
  Image values = buffer_values(gbuffer, name);
  const float* alpha = gbuffer.plane(kAlpha);
  float near = 1e30f, far = 0;
  for (size_t i = 0; buffer.plane == kDepth && i < gbuffer.pixels(); ++i)
    if (alpha[i] > 0.5f) {
      near = std::min(near, values.data[i]);
      far = std::max(far, values.data[i]);
    }
  Image8 out(gbuffer.width, gbuffer.height, 3);
  for (size_t i = 0; i < gbuffer.pixels(); ++i)
    for (int c = 0; c < 3; ++c) {
      float v = buffer.channels == 2 && c == 2
                    ? 0.0f
                    : values.data[i * buffer.channels + std::min(c, buffer.channels - 1)];
      if (buffer.plane == kAlbedo) v = srgb_from_linear(v);
      if (buffer.plane == kNormal || buffer.plane == kMappedNormal) v = 0.5f * (v + 1);
      if (buffer.plane == kDepth) v = far > near ? (far - v) / (far - near) : 0.0f;
      if (buffer.plane != kAlpha) v *= alpha[i];
      out.data[i * 3 + c] = static_cast<uint8_t>(std::lround(std::clamp(v, 0.0f, 1.0f) * 255));
    }
  return out;
}

double exposure_to_match(const Cubemap& light, const Cubemap& reference) {
  const double have = mean_radiance(light);
  return have > 0 ? mean_radiance(reference) / have : 1.0;
}

}  // namespace effigy
