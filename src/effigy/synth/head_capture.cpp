#include "effigy/synth/head_capture.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/log.h"
#include "effigy/base/progress.h"
#include "effigy/base/threads.h"
#include "effigy/capture/capture.h"
#include "effigy/image/files.h"
#include "effigy/image/resample.h"
#include "effigy/light/builtin_lights.h"
#include "effigy/people/builtin_head.h"
#include "effigy/rays/ray_scene.h"
#include "effigy/shade/deferred.h"
#include "effigy/splat/surfel_raster.h"

namespace effigy {
namespace {

constexpr double kFramesPerSecond = 24;
constexpr double kFieldOfView = 0.35;  // radians, vertical
constexpr double kDistance = 1.0;      // metres from camera to the head's root

// Per triangle: direction of increasing u on the surface and the handedness of its UVs.
struct Tangent {
  Vec3f direction;
  float handedness;
};

// One posed head that rays can meet.
class PosedHead {
 public:
  PosedHead(const Mesh& mesh, const HeadMaterials& materials, std::vector<float> vertices)
      : mesh_(mesh),
        materials_(materials),
        vertices_(std::move(vertices)),
        normals_(vertex_normals(vertices_, mesh.triangles)),
        scene_(vertices_, mesh.triangles) {
    tangents_.reserve(mesh.triangles.size());
    for (size_t t = 0; t < mesh.triangles.size(); ++t) tangents_.push_back(tangent_of(t));
  }

  // G-buffer with alpha 0 or 1 at each pixel centre.
  Planes trace(const Camera& camera) const {
    Planes gbuffer(camera.width, camera.height, kGBufferPlanes);
    parallel_for(static_cast<size_t>(camera.height), 8, [&](size_t begin, size_t end, int) {
      for (size_t y = begin; y < end; ++y)
        for (int x = 0; x < camera.width; ++x) trace_pixel(camera, x, static_cast<int>(y), gbuffer);
    });
    return gbuffer;
  }

 private:
  Vec3f position(int v) const { return Vec3f(&vertices_[3 * static_cast<size_t>(v)]); }
  Vec3f normal(int v) const { return Vec3f(&normals_[3 * static_cast<size_t>(v)]); }

  Tangent tangent_of(size_t t) const {
    const Vec3i& corner = mesh_.triangles[t];
    const Vec3i& uv = mesh_.uv_triangles[t];
    const Vec3f e1 = position(corner[1]) - position(corner[0]);
    const Vec3f e2 = position(corner[2]) - position(corner[0]);
    const Vec2f d1 = mesh_.uvs[uv[1]] - mesh_.uvs[uv[0]];
    const Vec2f d2 = mesh_.uvs[uv[2]] - mesh_.uvs[uv[0]];
    const float area = d1.x() * d2.y() - d1.y() * d2.x();
    const float sign = area < 0 ? -1.0f : 1.0f;
    const Vec3f along = sign * (e1 * d2.y() - e2 * d1.y());
    return {along.squaredNorm() > 0 ? Vec3f(along.normalized()) : Vec3f::UnitX(), sign};
  }

  void trace_pixel(const Camera& camera, int x, int y, Planes& gbuffer) const {
    const Vec3d ray_camera((x + 0.5 - camera.cx) / camera.fx, (y + 0.5 - camera.cy) / camera.fy, 1);
    const Vec3f ray = (camera.camera_from_world_rotation.transpose() * ray_camera).cast<float>();
    const RayHit hit = scene_.closest(camera.center().cast<float>(), ray, 0.01f);
    if (hit.triangle < 0) return;
    const float a = 1 - hit.b - hit.c;
    const Vec3i& corner = mesh_.triangles[hit.triangle];
    const Vec3i& uv_corner = mesh_.uv_triangles[hit.triangle];
    const Vec2f uv = a * mesh_.uvs[uv_corner[0]] + hit.b * mesh_.uvs[uv_corner[1]] +
                     hit.c * mesh_.uvs[uv_corner[2]];
    Vec3f n = (a * normal(corner[0]) + hit.b * normal(corner[1]) + hit.c * normal(corner[2]))
                  .normalized();
    const Tangent& frame = tangents_[hit.triangle];
    const Vec3f tangent = (frame.direction - n * n.dot(frame.direction)).normalized();
    const Vec3f bitangent = frame.handedness * n.cross(tangent);
    const double u = uv.x() * materials_.albedo.width;
    const double v = (1 - uv.y()) * materials_.albedo.height;
    float albedo[3], roughness, specular, bump[3];
    sample_bilinear(materials_.albedo, u, v, albedo);
    sample_bilinear(materials_.roughness, u, v, &roughness);
    sample_bilinear(materials_.specular, u, v, &specular);
    sample_bilinear(materials_.normal, u, v, bump);
    Vec3f mapped = (bump[0] * tangent + bump[1] * bitangent + bump[2] * n).normalized();
    if (n.dot(ray) > 0) {
      n = -n;
      mapped = -mapped;
    }
    const size_t i = static_cast<size_t>(y) * camera.width + x;
    const auto put = [&](int plane, float value) { gbuffer.plane(plane)[i] = value; };
    put(kAlpha, 1);
    put(kDepth, hit.distance);  // the ray's z is 1, so this is camera-space depth
    for (int c = 0; c < 3; ++c) {
      put(kAlbedo + c, albedo[c]);
      put(kNormal + c, n[c]);
      put(kMappedNormal + c, mapped[c]);
    }
    put(kRoughness, roughness);
    put(kSpecular, specular);
    put(kUv, uv.x());
    put(kUv + 1, uv.y());
  }

  const Mesh& mesh_;
  const HeadMaterials& materials_;
  std::vector<float> vertices_, normals_;
  std::vector<Tangent> tangents_;
  RayScene scene_;
};

class HeadCaptureWriter {
 public:
  HeadCaptureWriter(const SynthHeadOptions& options, const Path& folder)
      : options_(options),
        folder_(folder, "capture.json"),
        rig_(builtin_head_rig()),
        materials_(builtin_head_materials(options.texture_size)),
        shape_(shape_rig(rig_, {})) {
    camera_.width = camera_.height = options.size;
    camera_.fx = camera_.fy = 0.5 * options.size / std::tan(0.5 * kFieldOfView);
    camera_.cx = camera_.cy = 0.5 * options.size;
    camera_.camera_from_world_rotation = Vec3d(1, -1, -1).asDiagonal();
    large_ =
        camera_.resized(options.size * options.supersample, options.size * options.supersample);
    center_head();
  }

  void run() {
    lights_[options_.light] = prefilter_environment(builtin_light(options_.light));
    for (const std::string& name : options_.relight)
      lights_[name] = prefilter_environment(builtin_light(name));
    for (const auto& [name, light] : lights_)
      write_exr(folder_.dir() / "lights" / (name + ".exr"), builtin_light(name), false);
    start_capture();
    Progress progress("rendering the built-in head", "frames", options_.frames);
    for (int f = 0; f < options_.frames; ++f) {
      render_frame(f);
      progress.update(f + 1);
    }
    progress.finish();
    for (const auto& [name, images] : relit_)
      capture_.extra["relight"][name] = {{"light", "lights/" + name + ".exr"}, {"images", images}};
    capture_.extra["light"] = "lights/" + options_.light + ".exr";
    write_capture(capture_, folder_.dir());
    folder_.commit();
  }

 private:
  // The middle of the head's bounding box comes to rest on the camera's axis.
  void center_head() {
    Vec3f low = Vec3f::Constant(1e9f), high = -low;
    for (size_t v = 0; v + 2 < shape_.rest.size(); v += 3) {
      low = low.cwiseMin(Vec3f(&shape_.rest[v]));
      high = high.cwiseMax(Vec3f(&shape_.rest[v]));
    }
    offset_ = -0.5f * (low + high);
    offset_.z() = -static_cast<float>(kDistance);
  }

  void start_capture() {
    capture_.source = "the built-in head";
    capture_.licence = "Apache-2.0";
    capture_.consent = "not a real person";
    capture_.frames_per_second = kFramesPerSecond;
    capture_.camera = camera_;
    capture_.rig = rig_;
    capture_.identity.assign(rig_.identity_count, 0.0f);
    capture_.extra = Json::object();
    for (int f = 0; f < options_.frames; ++f) {
      CaptureFrame frame;
      frame.number = f;
      frame.seconds = f / kFramesPerSecond;
      const std::string name = format("{:06}.png", f);
      frame.image = "images/cam0/" + name;
      frame.mask = "masks/cam0/" + name;
      frame.albedo = "albedo/cam0/" + name;
      RigPose pose = performance_pose(rig_, frame.seconds, options_.seed);
      for (int c = 0; c < 3; ++c) pose.translation[c] += offset_[c];
      capture_.frames.push_back(frame);
      capture_.poses.push_back(std::move(pose));
    }
    split_test_frames(capture_);
  }

  void render_frame(int f) {
    std::vector<float> vertices;
    pose_vertices(shape_, capture_.poses[f], vertices);
    const PosedHead head(rig_.mesh, materials_, std::move(vertices));
    const Planes gbuffer = head.trace(large_);
    const CaptureFrame& frame = capture_.frames[f];
    const std::string name = format("{:06}.png", f);
    write_png8(folder_.dir() / frame.image, shade(gbuffer, options_.light));
    Image alpha(large_.width, large_.height, 1);
    std::copy_n(gbuffer.plane(kAlpha), gbuffer.pixels(), alpha.data.begin());
    write_png8(folder_.dir() / frame.mask, to_8bit(resize(alpha, options_.size, options_.size)));
    Image albedo(large_.width, large_.height, 3);
    for (size_t i = 0; i < gbuffer.pixels(); ++i)
      for (int c = 0; c < 3; ++c)
        albedo.data[3 * i + c] = srgb_from_linear(gbuffer.plane(kAlbedo + c)[i]);
    write_png8(folder_.dir() / frame.albedo, to_8bit(resize(albedo, options_.size, options_.size)));
    if (!is_relit(f)) return;
    for (const std::string& light : options_.relight) {
      const std::string path = "relight/" + light + "/" + name;
      write_png8(folder_.dir() / path, shade(gbuffer, light));
      relit_[light][std::to_string(frame.number)] = path;
    }
  }

  Image8 shade(const Planes& gbuffer, const std::string& light) const {
    Planes colour;
    shade_deferred(gbuffer, large_, lights_.at(light), {}, colour);
    return to_8bit(resize(to_image(colour), options_.size, options_.size));
  }

  // Whether frame f is one of the held-out frames that get relighting truth.
  bool is_relit(int f) const {
    const auto test = capture_.test_frames();
    const int count = std::min<int>(options_.relight_frames, static_cast<int>(test.size()));
    for (int k = 0; k < count; ++k)
      if (test[test.size() * k / count] == f) return true;
    return false;
  }

  SynthHeadOptions options_;
  FolderWriter folder_;
  Rig rig_;
  HeadMaterials materials_;
  RigShape shape_;
  Camera camera_, large_;
  Vec3f offset_ = Vec3f::Zero();
  std::map<std::string, PrefilteredEnvironment> lights_;
  std::map<std::string, Json> relit_;
  Capture capture_;
};

}  // namespace

void synth_head_capture(const SynthHeadOptions& options, const Path& folder) {
  if (options.frames < 4 || options.size < 32 || options.supersample < 1)
    throw Error("A synthetic capture needs at least 4 frames of 32 pixels and 1 ray a pixel.");
  HeadCaptureWriter(options, folder).run();
}

}  // namespace effigy
