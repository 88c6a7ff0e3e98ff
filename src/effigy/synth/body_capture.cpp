#include "effigy/synth/body_capture.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <map>
#include <memory>

#include "effigy/base/json.h"
#include "effigy/base/log.h"
#include "effigy/base/progress.h"
#include "effigy/image/colour.h"
#include "effigy/image/files.h"
#include "effigy/rig/rig_file.h"
#include "effigy/splat/surfel_raster.h"
#include "effigy/synth/option_range.h"
#include "effigy/synth/truth_image.h"

namespace effigy {
namespace {

namespace fs = std::filesystem;
constexpr int kLayerSamples = 16, kIrradianceSamples = 16;
constexpr double kImageBytes = 0.3, kLayerBytes = 3.2;  // a pixel, about, as measured
constexpr double kLightBytes = 9;                       // of an environment's pixel
constexpr const char* kPlanFile = "plan.json";

void check_options(const SynthBodyOptions& o) {
  check_range("--spp", o.samples, 1, kMostSamples);
  check_range("--bounces", o.bounces, 1, kMostBounces);
  check_range("--relight-frames", o.relight_frames, 0, kMostFrames);
  check_range("--tracking-error", o.tracking_error, 0.0, 100.0);
  check_range("--texture-size", o.texture_size, kLeastTexels, kMostTexels);
  // Broken files show before the work begins.
  for (const std::string& file : {o.motion, o.unseen_motion})
    if (!file.empty()) read_bvh(file);
}

// All that decides what a capture holds.
Json plan_json(const SynthBodyOptions& o) {
  const StageOptions& s = o.stage;
  return {{"cameras", s.cameras},
          {"lights", s.lights},
          {"light_file", s.light_file},
          {"light_up", static_cast<int>(s.light_up)},
          {"radius", s.radius},
          {"height", s.height},
          {"size", {s.width, s.height_pixels}},
          {"frames", s.frames},
          {"unseen_frames", s.unseen_frames},
          {"frames_per_second", s.frames_per_second},
          {"lighting", static_cast<int>(s.lighting)},
          {"framing", s.framing == StageFraming::kPerson ? "person" : "dome"},
          {"seed", s.seed},
          {"subject", o.subject},
          {"body", o.body},
          {"motion", o.motion},
          {"unseen_motion", o.unseen_motion},
          {"environment", o.environment},
          {"relight", o.relight},
          {"relight_frames", o.relight_frames},
          {"samples", o.samples},
          {"bounces", o.bounces},
          {"texture_size", o.texture_size},
          {"true_mesh", o.true_mesh},
          {"layers", o.layers},
          {"subsurface", o.subsurface},
          {"tracking_error", o.tracking_error}};
}

// Stage and frames of the capture; environments by their name in the capture.
struct Protocol {
  LightStage stage;
  std::vector<StageFrame> frames;
  std::vector<int> moment;                          // per frame: the frame whose pose it shows
  std::map<std::string, std::string> environments;  // path in the capture -> name or file
  std::map<std::string, Image> images;              // path in the capture -> radiance
  int seen = 0, unseen = 0;
};

Path environment_path(const std::string& light) {
  return Path("lights") / (synth_light_name(light) + ".exr");
}

Protocol make_protocol(const SynthBodyOptions& o) {
  Protocol p;
  p.stage = make_light_stage(o.stage);
  p.frames = plan_stage_frames(o.stage, static_cast<int>(p.stage.lights.size()));
  const auto add_environment = [&](const std::string& light) {
    Path path = environment_path(light);
    const auto [found, fresh] = p.environments.try_emplace(path.string(), light);
    if (fresh) p.images[path.string()] = synth_light(light);
    if (found->second != light)
      throw Error("The lights '" + light + "' and '" + found->second +
                  "' would have the same name in the capture; rename one file.");
    return path;
  };
  std::vector<int> unseen;
  for (size_t f = 0; f < p.frames.size(); ++f) {
    p.moment.push_back(static_cast<int>(f));
    if (p.frames[f].split == StageSplit::kMotion) unseen.push_back(static_cast<int>(f));
    if (o.stage.lighting == StageLighting::kEnvironment)
      p.frames[f].environment = add_environment(o.environment);
  }
  p.unseen = static_cast<int>(unseen.size());
  p.seen = static_cast<int>(p.frames.size()) - p.unseen;
  const int again = std::min(o.relight_frames, p.unseen);
  for (const std::string& light : o.relight)
    for (int k = 0; k < again; ++k) {
      StageFrame frame;
      p.moment.push_back(unseen[static_cast<size_t>(k) * unseen.size() / again]);
      frame.number = static_cast<int64_t>(p.frames.size());
      frame.seconds = p.frames[static_cast<size_t>(p.moment.back())].seconds;
      frame.split = StageSplit::kEnvironment;
      frame.environment = add_environment(light);
      p.frames.push_back(std::move(frame));
    }
  return p;
}

BodySceneOptions scene_options(const SynthBodyOptions& o, const Protocol& p) {
  BodySceneOptions s;
  s.subject = o.subject;
  s.body = o.body;
  s.texture_size = o.texture_size;
  s.frames_per_second = o.stage.frames_per_second;
  s.frames = p.seen;
  s.unseen_frames = p.unseen;
  s.motion = o.motion;
  s.unseen_motion = o.unseen_motion;
  s.seed = o.stage.seed;
  s.tracking_error = o.tracking_error;
  s.subsurface = o.subsurface;
  return s;
}

// The folder beside the final one in which a capture grows.
Path partial_path(Path folder) {
  if (folder.filename().empty()) folder = folder.parent_path();
  folder += ".partial";
  return folder;
}

class PartialFolder {
 public:
  PartialFolder(const Path& final_path, const Json& plan) : final_(final_path) {
    if (final_.filename().empty()) final_ = final_.parent_path();
    work_ = partial_path(final_);
    const bool taken =
        fs::exists(final_) && !(fs::is_directory(final_) &&
                                (fs::is_empty(final_) || fs::exists(final_ / "capture.json")));
    if (taken)
      throw Error(
          "Cannot write " + final_.string() + ": other files are in the way; choose another name.",
          Blame::kResource);
    if (!fs::exists(work_ / kPlanFile)) {
      if (fs::exists(work_) && !fs::is_empty(work_))
        throw Error(
            "Cannot write " + work_.string() + ": other files are in the way; choose another name.",
            Blame::kResource);
      write_json(work_ / kPlanFile, plan);
    } else if (read_json(work_ / kPlanFile) != plan) {
      if (!fs::exists(work_ / "images")) {  // nothing lost
        write_json(work_ / kPlanFile, plan);
        return;
      }
      throw Error(work_.string() +
                  ": it holds an unfinished capture of other options; run its command again to "
                  "finish it, or delete it.");
    }
  }
  // Nothing stays of a capture without images.
  ~PartialFolder() {
    std::error_code ignored;
    if (!fs::exists(work_ / "images", ignored)) fs::remove_all(work_, ignored);
  }
  PartialFolder(const PartialFolder&) = delete;
  PartialFolder& operator=(const PartialFolder&) = delete;
  const Path& dir() const { return work_; }
  void commit() const {
    fs::remove(work_ / kPlanFile);
    std::error_code error;
    Path old = final_;
    old += ".old";
    const bool replaced = fs::exists(final_);
    if (replaced) {
      fs::remove_all(old, error);
      fs::rename(final_, old, error);
    }
    fs::rename(work_, final_, error);
    if (error)
      throw Error("Cannot rename " + work_.string() + " to " + final_.string() + ": " +
                      error.message() + ".",
                  Blame::kResource);
    if (replaced) fs::remove_all(old, error);
  }

 private:
  Path final_, work_;
};

class BodyCaptureWriter {
 public:
  BodyCaptureWriter(const SynthBodyOptions& options, const Path& folder)
      : options_(options),
        protocol_(make_protocol(options)),
        folder_(folder, plan_json(options)),
        body_(scene_options(options, protocol_)) {
    if (options.stage.framing == StageFraming::kPerson)
      frame_cameras(body_.reach(), protocol_.stage.cameras);
    body_.check_outside(protocol_.stage.cameras);
    trace_.samples = options.samples;
    trace_.bounces = options.bounces;
    trace_.seed = options.stage.seed;
    for (const auto& [path, image] : protocol_.images) {
      environments_[path] = std::make_shared<EnvironmentSampler>(image);
      if (!fs::exists(folder_.dir() / path)) write_exr(folder_.dir() / path, image, false);
    }
  }

  SynthBodyResult run() {
    const auto begin = std::chrono::steady_clock::now();
    start_capture();
    const int64_t images = static_cast<int64_t>(capture_.frames.size() * capture_.cameras.size());
    int64_t made = 0;
    for (size_t f = 0; f < capture_.frames.size(); ++f)
      for (size_t c = 0; c < capture_.cameras.size(); ++c) made += done(f, c) ? 1 : 0;
    SynthBodyResult result;
    result.kept = static_cast<int>(made);
    render(made);
    finish_capture();
    result.frames = static_cast<int>(capture_.frames.size());
    result.images = static_cast<int>(images);
    result.seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    return result;
  }

 private:
  void start_capture() {
    const bool own = !options_.body.empty();
    const std::string who = own ? Path(options_.body).filename().string()
                                : "the built-in body, subject " + std::to_string(options_.subject);
    capture_.source = who + ", in a light stage";
    capture_.licence = own ? body_.rig().licence : "Apache-2.0";
    capture_.consent = own ? "not stated" : "not a real person";
    capture_.frames_per_second = options_.stage.frames_per_second;
    capture_.cameras = protocol_.stage.cameras;
    capture_.lights = protocol_.stage.lights;
    capture_.frames = protocol_.frames;
    capture_.rig = body_.rig();
    capture_.parts = body_.label_names();
    capture_.body_keypoint_names = body_.body_keypoint_names();
    capture_.face_keypoint_names = body_.face_keypoint_names();
    const size_t frames = capture_.frames.size();
    capture_.body_keypoints.resize(3 * frames * capture_.body_keypoint_names.size());
    capture_.face_keypoints.resize(3 * frames * capture_.face_keypoint_names.size());
    capture_.body_from_rest.resize(frames);
    capture_.face_from_rest.resize(frames);
    for (const int m : protocol_.moment) {
      capture_.poses.push_back(body_.tracked_poses()[static_cast<size_t>(m)]);
      capture_.true_poses.push_back(body_.true_poses()[static_cast<size_t>(m)]);
    }
  }

  void render(int64_t made) {
    const auto images = static_cast<int64_t>(capture_.frames.size() * capture_.cameras.size());
    Progress progress("rendering the light stage", "images", images, made);
    for (int moment = 0; moment < protocol_.seen + protocol_.unseen; ++moment) {
      body_.advance();
      bool shown = false;
      for (size_t f = static_cast<size_t>(moment); f < capture_.frames.size(); ++f)
        if (protocol_.moment[f] == moment) render_frame(f, shown, made, progress);
    }
    progress.finish();
  }

  // The image is a view's last file.
  bool done(size_t frame, size_t camera) const {
    return fs::exists(folder_.dir() / stage_image_path(capture_.cameras[camera].name,
                                                       capture_.frames[frame].number));
  }

  void render_frame(size_t f, bool& shown, int64_t& made, Progress& progress) {
    keep_tracking(f);
    bool whole = true;
    for (size_t c = 0; c < capture_.cameras.size(); ++c) whole = whole && done(f, c);
    if (whole) return;
    light(f);
    write_arrays(f, shown);
    if (!shown) {
      body_.show(body_.truth());
      shown = true;
    }
    for (size_t c = 0; c < capture_.cameras.size(); ++c) {
      if (done(f, c)) continue;
      render_view(f, c);
      progress.update(++made);
    }
  }

  void keep_tracking(size_t f) {
    const BodyKeypoints keypoints = body_.keypoints();
    const size_t body = keypoints.body.size(), face = keypoints.face.size();
    std::copy_n(keypoints.body.data(), body, capture_.body_keypoints.data() + f * body);
    std::copy_n(keypoints.face.data(), face, capture_.face_keypoints.data() + f * face);
    const auto frames = body_.root_frames();
    capture_.body_from_rest[f] = frames[0];
    capture_.face_from_rest[f] = frames[1];
  }

  void light(size_t f) {
    const StageFrame& frame = capture_.frames[f];
    const bool environment = !frame.environment.empty();
    body_.scene().set_environment(environment ? environments_.at(frame.environment.string())
                                              : nullptr);
    body_.scene().set_point_lights(environment ? std::vector<StageLight>{}
                                               : capture_.lights_of(static_cast<int>(f)));
  }

  // Mesh, truth and the normalised irradiance on the mesh that training knows.
  void write_arrays(size_t f, bool& shown) {
    StageFrameArrays arrays;
    arrays.tracked = options_.true_mesh ? body_.truth() : body_.tracked();
    if (options_.layers) {
      body_.show(arrays.tracked);
      arrays.irradiance =
          vertex_irradiance(body_.scene(), 0, kIrradianceSamples, options_.stage.seed);
      shown = options_.true_mesh;
    }
    arrays.truth = body_.truth();
    write_frame_arrays(arrays, folder_.dir(), capture_.frames[f].number);
  }

  void render_view(size_t f, size_t c) {
    const StageCamera& camera = capture_.cameras[c];
    const int64_t number = capture_.frames[f].number;
    Image radiance;
    try {
      radiance = trace_image(body_.scene(), camera.camera, trace_);
    } catch (const Interrupted&) {
      throw;
    } catch (const Error& error) {
      throw Error(
          "Frame " + std::to_string(number) + ", camera " + camera.name + ": " + error.what(),
          error.blame());
    }
    if (options_.layers) write_layers(camera, number, radiance);
    write_png8(folder_.dir() / stage_mask_path(camera.name, number), to_8bit(alpha_image(radiance)),
               {}, true);
    write_png8(folder_.dir() / stage_image_path(camera.name, number),
               to_8bit(display_image(radiance)), {}, true);
  }

  void write_layers(const StageCamera& camera, int64_t number, const Image& radiance) {
    const SurfaceLayers layers =
        trace_layers(body_.scene(), camera.camera, kLayerSamples, options_.stage.seed);
    const auto write = [&](const char* name, const Image& image, bool half) {
      write_exr(folder_.dir() / stage_layer_path(name, camera.name, number), image, half);
    };
    write("radiance", radiance, true);
    write("albedo", layers.albedo, true);
    write("material", layers.material, true);
    write("normal", planes_image(layers.gbuffer, kMappedNormal, 3), true);
    write("depth", planes_image(layers.gbuffer, kDepth, 1), false);
    const Image uv = planes_image(layers.gbuffer, kUv, 2);
    write("uv", uv, false);
    Image8 part(radiance.width, radiance.height, 1);
    for (size_t i = 0; i < part.data.size(); ++i)
      if (layers.part[i] > 0)
        part.data[i] = body_.label(Vec2f(uv.data[2 * i], uv.data[2 * i + 1]), layers.part[i] - 1);
    write_png8(folder_.dir() / stage_layer_path("part", camera.name, number), part, {}, true);
  }

  void finish_capture() {
    if (options_.layers)
      capture_.layers = {"radiance", "albedo", "material", "normal", "depth", "uv", "part"};
    capture_.extra = {{"made", plan_json(options_)}};
    write_stage_capture(capture_, folder_.dir());
    folder_.commit();
  }

  SynthBodyOptions options_;
  Protocol protocol_;
  PartialFolder folder_;
  BodyScene body_;
  TraceOptions trace_;
  std::map<std::string, std::shared_ptr<const EnvironmentSampler>> environments_;
  StageCapture capture_;
};

// What only the body itself can tell of a capture.
struct Probe {
  double seconds = 0;      // that a sample of a fully lit view takes on this machine
  int64_t rig_bytes = 0;   // of the rig's file
  int64_t mesh_bytes = 0;  // of one array of vertices
  int64_t pose_bytes = 0;  // of one frame's parameters and keypoints
};
Probe probe_body(const SynthBodyOptions& options, const LightStage& stage) {
  constexpr int kSide = 96, kSamples = 16, kMoments = 16;
  BodySceneOptions scene;
  scene.subject = options.subject;
  scene.body = options.body;
  scene.texture_size = 256;
  scene.subsurface = options.subsurface;
  scene.frames_per_second = 1;
  scene.frames = kMoments;
  scene.seed = options.stage.seed;
  BodyScene body(scene);
  StageCamera view = stage.cameras[0];
  view.camera = view.camera.resized(kSide, kSide);
  if (options.stage.framing == StageFraming::kPerson) frame_cameras(body.reach(), {&view, 1});
  body.advance();
  body.show(body.truth());
  body.scene().set_point_lights(stage.lights);
  TraceOptions trace;
  trace.samples = kSamples;
  trace.bounces = options.bounces;
  const auto begin = std::chrono::steady_clock::now();
  trace_image(body.scene(), view.camera, trace);
  const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - begin;
  const Rig& rig = body.rig();
  constexpr int64_t kNumber = sizeof(float), kTransforms = 24;
  const auto keypoints =
      static_cast<int64_t>(body.body_keypoint_names().size() + body.face_keypoint_names().size());
  return {taken.count() / (kSide * kSide * kSamples), rig_file_bytes(rig),
          kNumber * static_cast<int64_t>(rig.mesh.vertices.size()),
          kNumber * (2 * (rig.expression_count + 3 * rig.joint_count() + 3) + 3 * keypoints +
                     kTransforms)};
}

}  // namespace

SynthBodyPlan plan_body_capture(const SynthBodyOptions& options) {
  check_options(options);
  const Protocol protocol = make_protocol(options);
  SynthBodyPlan plan;
  plan.cameras = static_cast<int>(protocol.stage.cameras.size());
  for (const StageCamera& camera : protocol.stage.cameras) plan.test_cameras += camera.test;
  plan.lights = static_cast<int>(protocol.stage.lights.size());
  plan.frames = static_cast<int>(protocol.frames.size());
  for (const StageFrame& frame : protocol.frames) {
    plan.train += frame.split == StageSplit::kTrain;
    plan.held_out_lights += frame.split == StageSplit::kLights;
    plan.unseen += frame.split == StageSplit::kMotion;
    plan.relit += frame.split == StageSplit::kEnvironment;
    plan.fully_lit += frame.fully_lit;
  }
  const int64_t pixels = int64_t{options.stage.width} * options.stage.height_pixels;
  plan.images = int64_t{plan.frames} * plan.cameras;
  plan.samples = plan.images * pixels * options.samples;
  const double all_pixels = static_cast<double>(plan.images * pixels);
  const Probe probe = probe_body(options, protocol.stage);
  const int meshes = options.layers ? 3 : 2;  // tracked, true, irradiance
  plan.bytes = static_cast<int64_t>(all_pixels * (options.layers ? kLayerBytes : kImageBytes)) +
               probe.rig_bytes + plan.frames * (meshes * probe.mesh_bytes + probe.pose_bytes);
  for (const auto& [path, light] : protocol.images)
    plan.bytes += static_cast<int64_t>(kLightBytes * light.width * light.height);
  const double samples = options.samples + (options.layers ? kLayerSamples : 4);
  plan.seconds = probe.seconds * all_pixels * samples;
  return plan;
}

SynthBodyResult synth_body_capture(const SynthBodyOptions& options, const Path& folder) {
  check_options(options);
  try {
    return BodyCaptureWriter(options, folder).run();
  } catch (const Interrupted&) {
    clear_progress_line();
    const Path work = partial_path(folder);
    if (fs::exists(work))
      log_info("What is done stays in " + work.string() + "; the same command goes on with it.");
    throw;
  }
}

}  // namespace effigy
