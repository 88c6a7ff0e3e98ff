#include "effigy/head/evaluate.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "effigy/base/progress.h"
#include "effigy/head/model.h"
#include "effigy/image/metrics.h"
#include "effigy/learn/adam.h"
#include "effigy/learn/image_losses.h"

namespace effigy {
namespace {

// Half-width of the matte's erosion for coverage, as a share of the image's height (4 of 512).
constexpr double kErode = 4.0 / 512;

Image rounded(const Planes& planes) {
  Image image = to_image(planes);
  for (float& v : image.data) v = std::round(std::clamp(v, 0.0f, 1.0f) * 255) / 255;
  return image;
}

// 1 where the matte is over one half in the whole square of half-width `radius`.
std::vector<uint8_t> erode(const Planes& mask, int radius) {
  const int w = mask.width, h = mask.height;
  std::vector<uint8_t> rows(mask.pixels()), out(mask.pixels());
  const auto pass = [&](auto&& read, std::vector<uint8_t>& write, int dx, int dy) {
    for (int y = 0; y < h; ++y)
      for (int x = 0; x < w; ++x) {
        bool all = true;
        for (int k = -radius; all && k <= radius; ++k) {
          const int u = x + k * dx, v = y + k * dy;
          all = u >= 0 && v >= 0 && u < w && v < h && read(static_cast<size_t>(v) * w + u);
        }
        write[static_cast<size_t>(y) * w + x] = all;
      }
  };
  pass([&](size_t i) { return mask.data[i] > 0.5f; }, rows, 1, 0);
  pass([&](size_t i) { return rows[i] != 0; }, out, 0, 1);
  return out;
}

// One test image's pose, improved by Adam with the avatar frozen.
class PoseRefiner {
 public:
  PoseRefiner(const HeadAvatar& avatar, const Camera& camera)
      : avatar_(avatar),
        camera_(camera),
        light_(Prefilter(avatar.environment.size).forward(avatar.environment)) {
    shade_.display = avatar.display;
  }

  RigPose refine(const RigPose& start, const TargetFrame& target, int steps) {
    RigPose pose = start;
    const size_t size = pose_size(avatar_.rig);
    std::vector<float> flat(size), gradient(size);
    pack_pose(pose, flat);
    AdamState state(size);
    for (int i = 0; i < steps; ++i) {
      gradient_of(pose, target, gradient);
      descend(flat, gradient, state);
      unpack_pose(flat, pose);
    }
    return pose;
  }

 private:
  // Adam with one rate for expression, rotation and translation each.
  void descend(std::vector<float>& flat, const std::vector<float>& gradient, AdamState& state) {
    std::vector<float> unit(flat.size(), 0.0f);
    adam_step(unit, gradient, state, 1.0f);
    const size_t expressions = avatar_.rig.expression_count;
    for (size_t k = 0; k < flat.size(); ++k) {
      const float rate = k < expressions ? 1e-2f : (k < flat.size() - 3 ? 2e-3f : 3e-4f);
      flat[k] += rate * unit[k];
    }
  }

  void gradient_of(const RigPose& pose, const TargetFrame& target, std::vector<float>& gradient) {
    pose_vertices(avatar_.shape, pose, vertices_);
    pose_surfels(avatar_.rig.mesh, vertices_, avatar_.surfels, avatar_.bind, posed_);
    render_surfels(camera_, posed_, avatar_.material, {}, gbuffer_, frame_);
    shade_deferred(gbuffer_, camera_, light_, shade_, colour_);
    d_colour_ = Planes(camera_.width, camera_.height, 3);
    d_gbuffer_ = Planes(camera_.width, camera_.height, kGBufferPlanes);
    const size_t n = colour_.pixels();
    photometric_loss(colour_, target.image, {gbuffer_.plane(kAlpha), n}, target.mask.data, {},
                     &d_colour_, {d_gbuffer_.plane(kAlpha), n});
    shade_deferred_backward(gbuffer_, camera_, light_, shade_, d_colour_, d_gbuffer_, nullptr);
    d_posed_.resize(0);
    d_posed_.resize(posed_.count());
    d_texels_.assign(avatar_.material.texels.size(), 0.0f);
    render_surfels_backward(camera_, posed_, avatar_.material, {}, gbuffer_, frame_, d_gbuffer_,
                            d_posed_, d_texels_);
    d_bound_.clear(avatar_.surfels, vertices_.size());
    pose_surfels_backward(avatar_.rig.mesh, vertices_, avatar_.surfels, avatar_.bind, d_posed_,
                          d_bound_);
    RigGradient rig;
    rig.expression.assign(pose.expression.size(), 0.0f);
    rig.joint_rotation.assign(pose.joint_rotation.size(), 0.0f);
    pose_vertices_backward(avatar_.shape, pose, d_bound_.vertices, rig);
    pack_pose({rig.expression, rig.joint_rotation, rig.translation}, gradient);
  }

  const HeadAvatar& avatar_;
  Camera camera_;
  PrefilteredEnvironment light_;
  ShadeOptions shade_;
  std::vector<float> vertices_, d_texels_;
  PosedSurfels posed_, d_posed_;
  SurfelFrame frame_;
  Planes gbuffer_, colour_, d_gbuffer_, d_colour_;
  BoundSurfelGradients d_bound_;
};

}  // namespace

FrameScore ProtocolScores::mean() const {
  FrameScore sum;
  for (const FrameScore& f : frames) {
    sum.psnr += f.psnr;
    sum.psnr_foreground += f.psnr_foreground;
    sum.ssim += f.ssim;
    sum.coverage += f.coverage;
    sum.flip += f.flip;
    for (const auto& [name, value] : f.distances) sum.distances[name] += value;
  }
  const double n = std::max<size_t>(1, frames.size());
  for (auto& [name, value] : sum.distances) value /= n;
  return {0,
          sum.psnr / n,
          sum.psnr_foreground / n,
          sum.ssim / n,
          sum.coverage / n,
          sum.flip / n,
          sum.distances};
}

Json ProtocolScores::to_json() const {
  const FrameScore m = mean();
  Json per_frame = Json::array();
  for (const FrameScore& f : frames) {
    Json entry = {{"frame", f.frame},
                  {"psnr", f.psnr},
                  {"ssim", f.ssim},
                  {"coverage", f.coverage},
                  {"flip", f.flip}};
    for (const auto& [name, value] : f.distances) entry[name] = value;
    per_frame.push_back(std::move(entry));
  }
  Json json = {{"frames", frames.size()},
               {"psnr", m.psnr},
               {"psnr_foreground", m.psnr_foreground},
               {"ssim", m.ssim},
               {"coverage", m.coverage},
               {"flip", m.flip},
               {"lpips", nullptr},
               {"feature_squeezenet10", nullptr},
               {"per_frame", per_frame}};
  for (const auto& [name, value] : m.distances) json[name] = value;
  return json;
}

FrameScore score_frame(const Planes& colour, const Planes& gbuffer, const TargetFrame& target,
                       double neck_line, const std::vector<ImageDistance>& distances) {
  const Image rendered = rounded(colour), truth = rounded(target.image);
  FrameScore score;
  score.psnr = psnr(truth, rendered);
  score.ssim = ssim(truth, rendered);
  score.flip = flip(truth, rendered);
  for (const ImageDistance& distance : distances)
    score.distances[distance.name] = distance.between(truth, rendered);
  Image foreground(colour.width, colour.height, 1);
  for (int y = 0; y < colour.height && y + 0.5 < neck_line; ++y)
    for (int x = 0; x < colour.width; ++x)
      *foreground.at(x, y) = target.mask.data[static_cast<size_t>(y) * colour.width + x];
  score.psnr_foreground = psnr(truth, rendered, &foreground);
  const int radius = std::max(1, static_cast<int>(std::lround(kErode * colour.height)));
  const auto inner = erode(target.mask, radius);
  double alpha = 0, count = 0;
  for (size_t i = 0; i < inner.size(); ++i)
    if (inner[i]) {
      alpha += gbuffer.plane(kAlpha)[i];
      count += 1;
    }
  score.coverage = count > 0 ? alpha / count : 0;
  return score;
}

double neck_row(const HeadAvatar& avatar, const std::vector<float>& vertices,
                const Camera& camera) {
  double row = camera.height;
  for (int v : avatar.rig.neck_ring) {
    const float* p = &vertices[3 * static_cast<size_t>(v)];
    const Vec3d in_camera = camera.to_camera({p[0], p[1], p[2]});
    if (in_camera.z() > 0.01)
      row = std::min(row, camera.fy * in_camera.y() / in_camera.z() + camera.cy);
  }
  return row;
}

void check_rigs_agree(const HeadAvatar& avatar, const Capture& capture) {
  if (avatar.rig.kind != capture.rig.kind ||
      avatar.rig.expression_names != capture.rig.expression_names ||
      avatar.rig.joint_names != capture.rig.joint_names)
    throw Error(capture.folder.string() + ": its rig (" + capture.rig.kind +
                ") is not the avatar's (" + avatar.rig.kind +
                "); track the video with the avatar's rig (--rig).");
}

RigPose tracked_pose(const HeadAvatar& avatar, const Capture& capture, int frame) {
  return avatar.encoder ? encoded_poses(*avatar.encoder, capture, {frame}).front()
                        : capture.poses[frame];
}

namespace {

std::vector<RigPose> tracker_poses(const Capture& capture, const std::vector<int>& frames) {
  std::vector<RigPose> poses;
  for (const int frame : frames) poses.push_back(capture.poses[frame]);
  return poses;
}

std::vector<RigPose> tracked_poses(const HeadAvatar& avatar, const Capture& capture,
                                   const std::vector<int>& frames) {
  std::vector<RigPose> poses;
  for (const int frame : frames) poses.push_back(tracked_pose(avatar, capture, frame));
  return poses;
}

ProtocolScores evaluate_poses(const HeadAvatar& avatar, const Capture& capture,
                              const std::vector<int>& frames, std::vector<RigPose> poses,
                              const std::vector<ImageDistance>& distances) {
  ProtocolScores scores;
  HeadRenderer renderer(avatar);
  FrameStore store(capture, 0);
  TargetFrame target;
  std::optional<Progress> progress;  // these take seconds a frame
  if (!distances.empty())
    progress.emplace("scoring test frames", "frames", static_cast<int64_t>(frames.size()));
  for (size_t i = 0; i < frames.size(); ++i) {
    throw_if_interrupted();
    store.load(frames[i], target);
    renderer.set_pose(poses[i]);
    const Planes& colour = renderer.draw(capture.camera);
    FrameScore score =
        score_frame(colour, renderer.gbuffer(), target,
                    neck_row(avatar, renderer.vertices(), capture.camera), distances);
    score.frame = frames[i];
    scores.frames.push_back(score);
    if (progress) progress->update(static_cast<int64_t>(scores.frames.size()));
  }
  scores.poses = std::move(poses);
  return scores;
}

}  // namespace

ProtocolScores evaluate_tracker(const HeadAvatar& avatar, const Capture& capture,
                                const std::vector<int>& frames,
                                const std::vector<ImageDistance>& distances) {
  return evaluate_poses(avatar, capture, frames, tracker_poses(capture, frames), distances);
}

ProtocolScores evaluate_tracked(const HeadAvatar& avatar, const Capture& capture,
                                const std::vector<int>& frames,
                                const std::vector<ImageDistance>& distances) {
  return evaluate_poses(avatar, capture, frames, tracked_poses(avatar, capture, frames), distances);
}

ProtocolScores evaluate_refined(const HeadAvatar& avatar, const Capture& capture,
                                const std::vector<int>& frames, int steps,
                                const std::vector<ImageDistance>& distances) {
  ProtocolScores scores;
  const std::vector<RigPose> starts = tracked_poses(avatar, capture, frames);
  HeadRenderer renderer(avatar);
  PoseRefiner refiner(avatar, capture.camera);
  FrameStore store(capture, 0);
  TargetFrame target;
  Progress progress("refining test poses", "frames", static_cast<int64_t>(frames.size()));
  for (size_t i = 0; i < frames.size(); ++i) {
    store.load(frames[i], target);
    const RigPose pose = refiner.refine(starts[i], target, steps);
    renderer.set_pose(pose);
    const Planes& colour = renderer.draw(capture.camera);
    FrameScore score =
        score_frame(colour, renderer.gbuffer(), target,
                    neck_row(avatar, renderer.vertices(), capture.camera), distances);
    score.frame = frames[i];
    scores.frames.push_back(score);
    scores.poses.push_back(pose);
    progress.update(static_cast<int64_t>(i) + 1);
  }
  return scores;
}

}  // namespace effigy
