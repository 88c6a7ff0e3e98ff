#include "effigy/capture/import_stage.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <map>
#include <mutex>
#include <numbers>

#include "effigy/base/log.h"
#include "effigy/base/progress.h"
#include "effigy/base/threads.h"
#include "effigy/capture/import_source.h"
#include "effigy/image/files.h"
#include "effigy/image/resample.h"

namespace effigy {
namespace {

constexpr size_t kMeshKeypoints = 64;
constexpr int kBody = 128;  // of a mask: less is not counted

using Transform = std::array<float, 12>;

// The rotation that turns axis `up` of a source's world to +y.
Mat3d upright(const std::string& up) {
  Mat3d m = Mat3d::Identity();
  if (up == "y") return m;
  if (up == "-y") return Vec3d(1, -1, -1).asDiagonal();
  if (up == "z")
    m << 1, 0, 0, 0, 0, 1, 0, -1, 0;
  else if (up == "-z")
    m << 1, 0, 0, 0, 0, -1, 0, 1, 0;
  else if (up == "x")
    m << 0, -1, 0, 1, 0, 0, 0, 0, 1;
  else if (up == "-x")
    m << 0, 1, 0, -1, 0, 0, 0, 0, 1;
  else
    throw Error("--up must be x, y, z, -x, -y or -z, not '" + up + "'.");
  return m;
}

void turn(const Mat3d& m, std::vector<float>& points) {
  for (size_t i = 0; i + 2 < points.size(); i += 3) {
    const Vec3d p = m * Vec3f(&points[i]).cast<double>();
    for (size_t c = 0; c < 3; ++c) points[i + c] = static_cast<float>(p[static_cast<int>(c)]);
  }
}

Eigen::Map<const Eigen::Matrix3Xf> columns(const std::vector<float>& points) {
  return {points.data(), 3, static_cast<Eigen::Index>(points.size() / 3)};
}

Transform transform_of(const Mat3d& rotation, const Vec3d& translation) {
  Transform m;
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column)
      m[static_cast<size_t>(4 * row + column)] = static_cast<float>(rotation(row, column));
    m[static_cast<size_t>(4 * row + 3)] = static_cast<float>(translation[row]);
  }
  return m;
}

Transform turned(const Mat3d& m, const Transform& t) {
  Mat3d rotation;
  rotation << t[0], t[1], t[2], t[4], t[5], t[6], t[8], t[9], t[10];
  return transform_of(m * rotation, m * Vec3d(t[3], t[7], t[11]));
}

// Vertices that are far from one another, for sources without keypoints: each the farthest from
// those before it.
std::vector<int> spread_vertices(const std::vector<float>& vertices, size_t most) {
  const auto points = columns(vertices);
  std::vector<int> chosen;
  Eigen::VectorXf distance = (points.colwise() - points.rowwise().mean()).colwise().squaredNorm();
  while (chosen.size() < std::min<size_t>(most, vertices.size() / 3)) {
    Eigen::Index farthest = 0;
    distance.maxCoeff(&farthest);
    const Eigen::VectorXf from =
        (points.colwise() - points.col(farthest)).colwise().squaredNorm().transpose();
    distance = chosen.empty() ? from : distance.cwiseMin(from).eval();
    chosen.push_back(static_cast<int>(farthest));
  }
  return chosen;
}

// A rig of one joint, the mesh's middle, that everything follows.
void one_joint(Rig& rig) {
  const auto vertices = static_cast<size_t>(rig.mesh.vertex_count());
  rig.kind = "tracked-mesh";
  rig.joint_names = {"root"};
  rig.parents = {-1};
  rig.joint_regressor.assign(vertices, 1.0f / static_cast<float>(vertices));
  rig.weights.assign(vertices, 1.0f);
}

RigPose pose_of(const Rig& rig, const Transform& t) {
  Mat3d rotation;
  rotation << t[0], t[1], t[2], t[4], t[5], t[6], t[8], t[9], t[10];
  const Eigen::AngleAxisd turn(rotation);
  // The joint stays where it is when it turns.
  const Vec3d joint = columns(rig.mesh.vertices).rowwise().mean().cast<double>();
  const Vec3d shift = rotation * joint + Vec3d(t[3], t[7], t[11]) - joint;
  RigPose pose = RigPose::rest(rig);
  for (int c = 0; c < 3; ++c) {
    pose.joint_rotation[static_cast<size_t>(c)] = static_cast<float>(turn.angle() * turn.axis()[c]);
    pose.translation[static_cast<size_t>(c)] = static_cast<float>(shift[c]);
  }
  return pose;
}

class StageImport {
 public:
  StageImport(ImportedStage stage, const StageImportOptions& options, const Path& output)
      : stage_(std::move(stage)),
        options_(options),
        folder_(output, "capture.json"),
        out_(stage_.capture),
        turn_(upright(options.up.empty() ? stage_.up : options.up)) {
    report_.frames_left_out = stage_.frames_left_out;
    report_.first_problem = stage_.first_problem;
  }

  StageImportReport run() {
    choose_cameras();
    choose_frames();
    import_moments();
    place_lights();
    import_views();
    scale_lights();
    drop_unseen();
    finish();
    return report_;
  }

 private:
  void leave_out(const std::string& sentence) {
    if (report_.first_problem.empty()) report_.first_problem = sentence;
  }

  void choose_cameras() {
    for (size_t c = 0; c < out_.cameras.size(); ++c) camera_source_.push_back(static_cast<int>(c));
    if (!options_.cameras.empty()) {
      camera_source_.clear();
      for (const std::string& name : options_.cameras) {
        const auto found = std::find_if(out_.cameras.begin(), out_.cameras.end(),
                                        [&](const StageCamera& c) { return c.name == name; });
        if (found == out_.cameras.end())
          throw Error("The source has no camera '" + name +
                      "' with pictures and a calibration; choose among those it has (the first is "
                      "'" +
                      out_.cameras[0].name + "').");
        camera_source_.push_back(static_cast<int>(found - out_.cameras.begin()));
      }
      std::sort(camera_source_.begin(), camera_source_.end());
    }
    std::vector<StageCamera> cameras;
    for (const int c : camera_source_) {
      StageCamera camera = out_.cameras[static_cast<size_t>(c)];
      Camera& view = camera.camera;
      view.camera_from_world_rotation = view.camera_from_world_rotation * turn_.transpose();
      if (options_.scale < 1.0) {
        const auto side = [&](int n) {
          return std::max(1, static_cast<int>(std::lround(n * options_.scale)));
        };
        view = view.resized(side(view.width), side(view.height));
      }
      cameras.push_back(std::move(camera));
    }
    out_.cameras = std::move(cameras);
  }

  void choose_frames() {
    std::vector<int> frames;
    const auto every = static_cast<size_t>(options_.every);
    for (size_t f = 0; f < out_.frames.size(); f += every) frames.push_back(static_cast<int>(f));
    const auto most = static_cast<size_t>(options_.frames);
    for (size_t i = 0; most > 0 && i < most && most < frames.size(); ++i)
      frames[i] = frames[i * frames.size() / most];
    if (most > 0 && most < frames.size()) frames.resize(most);
    frame_source_ = std::move(frames);
  }

  void import_moments() {
    turn(turn_, out_.rig.mesh.vertices);
    one_joint(out_.rig);
    std::vector<int> points;
    if (stage_.keypoint_names.empty()) {
      points = spread_vertices(out_.rig.mesh.vertices, kMeshKeypoints);
      for (const int v : points) stage_.keypoint_names.push_back("vertex_" + std::to_string(v));
      log_info(format("the source has no keypoints: {} points of the tracked mesh stand in",
                      points.size()));
    }
    out_.body_keypoint_names = out_.face_keypoint_names = stage_.keypoint_names;
    out_.frames.clear();
    std::vector<int> kept;
    for (const int f : frame_source_) {
      throw_if_interrupted();
      try {
        add_moment(stage_.moment(f), stage_.capture.frames[static_cast<size_t>(f)], points);
        kept.push_back(f);
      } catch (const Error& error) {
        if (error.blame() != Blame::kInput) throw;
        ++report_.frames_left_out;
        leave_out(error.what());
      }
    }
    frame_source_ = std::move(kept);
    if (frame_source_.empty())
      throw Error("No frame of the source can be imported, the first problem: " +
                  report_.first_problem);
  }

  void add_moment(ImportedMoment moment, const StageFrame& frame, const std::vector<int>& points) {
    turn(turn_, moment.vertices);
    turn(turn_, moment.keypoints);
    for (const int v : points)
      for (size_t c = 0; c < 3; ++c)
        moment.keypoints.push_back(moment.vertices[3 * static_cast<size_t>(v) + c]);
    const std::string name = "frame " + std::to_string(frame.number) + " of the source: ";
    if (moment.vertices.size() != out_.rig.mesh.vertices.size())
      throw Error(name + "its mesh has " + std::to_string(moment.vertices.size() / 3) +
                  " vertices, the template has " + std::to_string(out_.rig.mesh.vertex_count()) +
                  "; give the template that belongs to it with --mesh.");
    if (moment.keypoints.size() != 3 * stage_.keypoint_names.size())
      throw Error(name + "it lacks keypoints that other frames have; repair it.");
    for (const auto* values : {&moment.vertices, &moment.keypoints})
      for (const float value : *values)
        if (!std::isfinite(value))
          throw Error(name + "a vertex or keypoint is not finite; repair it.");
    const Mat4d moved = Eigen::umeyama(columns(out_.rig.mesh.vertices).cast<double>().eval(),
                                       columns(moment.vertices).cast<double>().eval(), false);
    const Transform root = transform_of(moved.topLeftCorner<3, 3>(), moved.topRightCorner<3, 1>());
    write_frame_arrays({moment.vertices, {}, {}}, folder_.dir(), frame.number);
    out_.frames.push_back(frame);
    out_.frames.back().cameras.clear();
    out_.poses.push_back(pose_of(out_.rig, root));
    const Transform head = moment.root ? turned(turn_, *moment.root) : root;
    out_.body_from_rest.push_back(moment.root ? head : root);
    out_.face_from_rest.push_back(head);
    for (auto* all : {&out_.body_keypoints, &out_.face_keypoints})
      all->insert(all->end(), moment.keypoints.begin(), moment.keypoints.end());
  }

  void place_lights() {
    const auto& k = out_.body_keypoints;
    center_ = columns(k).rowwise().mean();
    for (StageLight& light : out_.lights) {
      light.position = (turn_ * light.position.cast<double>()).cast<float>();
      if (stage_.lights_at_center) light.intensity *= (light.position - center_).squaredNorm();
    }
  }

  // Whether the source says that this camera saw this frame.
  bool expected(size_t c, size_t f) const {
    const std::vector<int>& saw =
        stage_.capture.frames[static_cast<size_t>(frame_source_[f])].cameras;
    return saw.empty() || std::binary_search(saw.begin(), saw.end(), camera_source_[c]);
  }

  void import_views() {
    const size_t cameras = out_.cameras.size(), frames = out_.frames.size();
    seen_.assign(cameras * frames, 0);
    brightness_.resize(cameras);
    std::map<std::pair<size_t, size_t>, std::string> problems;  // by frame and camera
    std::mutex mutex;
    std::atomic<int64_t> done{0};
    Progress progress("importing", "views", static_cast<int64_t>(cameras * frames));
    parallel_for(cameras, 1, [&](size_t begin, size_t end, int slot) {
      for (size_t c = begin; c < end; ++c) {
        std::function<ImportedView(int)> read;
        for (size_t f = 0; f < frames; ++f, ++done) {
          if (!expected(c, f)) continue;
          throw_if_interrupted();
          try {
            if (!read) {
              read = stage_.open(camera_source_[c]);
              import_background(c);
            }
            import_view(read(frame_source_[f]), c, f);
            seen_[f * cameras + c] = 1;
          } catch (const Error& error) {
            if (error.blame() != Blame::kInput) throw;
            const std::lock_guard lock(mutex);
            problems[{f, c}] = error.what();
          }
          if (slot == 0) progress.update(done);
        }
      }
    });
    progress.update(done);
    report_.views = static_cast<size_t>(std::count(seen_.begin(), seen_.end(), 1));
    report_.views_left_out = problems.size();
    if (!problems.empty()) leave_out(problems.begin()->second);
    if (problems.size() > report_.views)
      throw Error(format("{} of {} views of the source cannot be imported, the first problem: {}",
                         problems.size(), problems.size() + report_.views, report_.first_problem));
  }

  void import_background(size_t c) {
    if (!stage_.background) return;
    StageCamera& camera = out_.cameras[c];
    Image8 image = stage_.background(camera_source_[c]);
    if (image.data.empty()) return;
    if (image.width != camera.camera.width || image.height != camera.camera.height)
      image = resize(image, camera.camera.width, camera.camera.height);
    write_png8(folder_.dir() / stage_background_path(camera.name), image, {}, true);
    camera.background = true;
  }

  void import_view(ImportedView view, size_t c, size_t f) {
    const StageCamera& camera = out_.cameras[c];
    const int64_t number = out_.frames[f].number;
    if (view.image.width != view.mask.width || view.image.height != view.mask.height)
      throw Error("Frame " + std::to_string(number) + " of camera " + camera.name +
                  ": its matte has another size than its picture; repair it.");
    const int width = camera.camera.width, height = camera.camera.height;
    if (view.image.width != width || view.image.height != height) {
      view.image = resize(view.image, width, height);
      view.mask = resize(view.mask, width, height);
    }
    write_png8(folder_.dir() / stage_image_path(camera.name, number), view.image, {}, true);
    write_png8(folder_.dir() / stage_mask_path(camera.name, number), view.mask, {}, true);
    Brightness sum{f, 0, 0};
    for (size_t i = 0; i < view.mask.data.size(); ++i) {
      if (view.mask.data[i] < kBody) continue;
      const uint8_t* p = &view.image.data[3 * i];
      sum.luminance += static_cast<double>(luminance(linear_[p[0]], linear_[p[1]], linear_[p[2]]));
      ++sum.pixels;
    }
    brightness_[c].push_back(sum);
  }

  // Lights and pictures share no unit: a factor on the light makes surfaces that look about in all
  // directions, and so see a quarter of it each, reflect kImportedAlbedo of it on average.
  void scale_lights() {
    std::vector<Brightness> of_frame(out_.frames.size());
    for (const auto& camera : brightness_)
      for (const Brightness& view : camera) {
        of_frame[view.frame].luminance += view.luminance;
        of_frame[view.frame].pixels += view.pixels;
      }
    std::vector<double> albedos;
    for (size_t f = 0; f < of_frame.size(); ++f) {
      if (of_frame[f].pixels == 0) continue;
      const double mean = of_frame[f].luminance / static_cast<double>(of_frame[f].pixels);
      double irradiance = 4 * std::numbers::pi;  // of radiance 1 all around, as points' sum
      if (out_.frames[f].environment.empty()) irradiance = at_center(static_cast<int>(f));
      if (mean > 0 && irradiance > 0) albedos.push_back(4 * std::numbers::pi * mean / irradiance);
    }
    double scale = options_.light_scale;
    if (!(scale > 0)) {
      scale = 1;
      if (!albedos.empty()) {
        const auto middle = albedos.begin() + static_cast<std::ptrdiff_t>(albedos.size() / 2);
        std::nth_element(albedos.begin(), middle, albedos.end());
        scale = *middle / kImportedAlbedo;
      }
    }
    for (StageLight& light : out_.lights) light.intensity *= static_cast<float>(scale);
    report_.light_scale = scale;
    if (stage_.lit_evenly)
      write_exr(folder_.dir() / kEvenLight, Image(8, 4, 3, static_cast<float>(scale)));
  }

  // Luminance of the irradiance at the stage's centre, facing each light.
  double at_center(int frame) const {
    double sum = 0;
    for (const StageLight& light : out_.lights_of(frame))
      sum += static_cast<double>(
          luminance(light.intensity.x(), light.intensity.y(), light.intensity.z()) /
          std::max((light.position - center_).squaredNorm(), 1e-12f));
    return sum;
  }

  // Frames and cameras of which no view was imported go; the others know who saw them.
  void drop_unseen() {
    const size_t cameras = out_.cameras.size();
    std::vector<int> number(cameras, -1);
    std::vector<StageCamera> kept;
    for (size_t c = 0; c < cameras; ++c) {
      bool any = false;
      for (size_t f = 0; f < out_.frames.size(); ++f) any |= seen_[f * cameras + c] != 0;
      if (!any) continue;
      number[c] = static_cast<int>(kept.size());
      kept.push_back(out_.cameras[c]);
    }
    StageCapture all = std::move(out_);
    out_ = all;
    for (auto* keypoints : {&out_.body_keypoints, &out_.face_keypoints}) keypoints->clear();
    out_.cameras = kept;
    out_.frames.clear();
    out_.poses.clear();
    out_.body_from_rest.clear();
    out_.face_from_rest.clear();
    const size_t row = 3 * out_.body_keypoint_names.size();
    for (size_t f = 0; f < all.frames.size(); ++f) {
      StageFrame frame = all.frames[f];
      for (size_t c = 0; c < cameras; ++c)
        if (seen_[f * cameras + c]) frame.cameras.push_back(number[c]);
      if (frame.cameras.empty()) {
        ++report_.frames_left_out;
        std::filesystem::remove(
            folder_.dir() / "frames" /
            stage_image_path("", frame.number).filename().replace_extension(".safetensors"));
        continue;
      }
      if (frame.cameras.size() == kept.size()) frame.cameras.clear();
      out_.frames.push_back(frame);
      out_.poses.push_back(all.poses[f]);
      out_.body_from_rest.push_back(all.body_from_rest[f]);
      out_.face_from_rest.push_back(all.face_from_rest[f]);
      const auto keypoints = all.body_keypoints.begin() + static_cast<std::ptrdiff_t>(f * row);
      for (auto* to : {&out_.body_keypoints, &out_.face_keypoints})
        to->insert(to->end(), keypoints, keypoints + static_cast<std::ptrdiff_t>(row));
    }
  }

  void finish() {
    if (!options_.consent.empty()) out_.consent = options_.consent;
    out_.extra["import"] = {{"light_scale", report_.light_scale},
                            {"frames_left_out", report_.frames_left_out},
                            {"views_left_out", report_.views_left_out}};
    report_.cameras = static_cast<int>(out_.cameras.size());
    report_.frames = static_cast<int>(out_.frames.size());
    write_stage_capture(out_, folder_.dir());
    folder_.commit();
    const size_t left = report_.views_left_out + static_cast<size_t>(report_.frames_left_out);
    if (left > 0)
      log_warning(format("left out {} frames and {} views, the first: {}", report_.frames_left_out,
                         report_.views_left_out, report_.first_problem));
  }

  // A view's body: sum of linear luminance over its pixels.
  struct Brightness {
    size_t frame = 0;
    double luminance = 0;
    size_t pixels = 0;
  };

  ImportedStage stage_;
  const StageImportOptions& options_;
  FolderWriter folder_;
  StageCapture out_;
  Mat3d turn_;                                     // upright from the source's world
  std::vector<int> camera_source_, frame_source_;  // of out_'s: numbers in stage_.capture
  Vec3f center_ = Vec3f::Zero();
  std::vector<uint8_t> seen_;                        // per frame and camera
  std::vector<std::vector<Brightness>> brightness_;  // per camera
  std::array<float, 256> linear_ = [] {
    std::array<float, 256> table;
    for (size_t i = 0; i < table.size(); ++i)
      table[i] = linear_from_srgb(static_cast<float>(i) / 255);
    return table;
  }();
  StageImportReport report_;
};

}  // namespace

const std::vector<std::string>& stage_import_kinds() {
  static const std::vector<std::string> kinds = {"goliath", "humanolat", "transforms"};
  return kinds;
}

StageImportReport import_stage(const std::string& kind, const Path& source,
                               const StageImportOptions& options, const Path& output) {
  if (!(options.scale > 0 && options.scale <= 1))
    throw Error("--scale must be above 0 and at most 1.");
  if (options.every < 1 || options.frames < 0)
    throw Error("--every must be at least 1, --frames at least 0.");
  if (!(options.light_scale >= 0) || !std::isfinite(options.light_scale))
    throw Error("--light-scale must be a positive number.");
  if (!std::filesystem::is_directory(source))
    throw Error(source.string() + ": there is no such folder; check the path.");
  ImportedStage stage = kind == "goliath"      ? open_goliath(source, options)
                        : kind == "humanolat"  ? open_humanolat(source, options)
                        : kind == "transforms" ? open_transforms(source, options)
                                               : throw Error("There is no importer for '" + kind +
                                                             "'; goliath, humanolat and transforms "
                                                             "are known.");
  return StageImport(std::move(stage), options, output).run();
}

}  // namespace effigy
