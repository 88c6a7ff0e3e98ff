#include "effigy/synth/head_capture.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <set>

#include "effigy/base/log.h"
#include "effigy/base/progress.h"
#include "effigy/capture/truth.h"
#include "effigy/image/colour.h"
#include "effigy/image/files.h"
#include "effigy/image/metrics.h"
#include "effigy/synth/head_scene.h"
#include "effigy/synth/option_range.h"
#include "effigy/synth/prior_image.h"
#include "effigy/synth/tracking_error.h"
#include "effigy/synth/truth_image.h"

namespace effigy {
namespace {

constexpr int kLayerSamples = 16, kIrradianceSamples = 16, kMostAcross = 4;

struct Light {
  Image image;
  std::shared_ptr<const EnvironmentSampler> sampler;
  PrefilteredEnvironment prefiltered;  // split-sum only
};

void check_options(const SynthHeadOptions& o) {
  check_range("--frames", o.frames, 4, kMostFrames);
  check_range("--size", o.size, 32, kMostPixels);
  check_range("--fps", o.frames_per_second, 0.01, 1000.0);
  check_range("--spp", o.samples, 1, kMostSamples);
  check_range("--bounces", o.bounces, 1, kMostBounces);
  check_range("--texture-size", o.texture_size, kLeastTexels, kMostTexels);
  check_range("--distance", o.distance, 1e-3, 1000.0);
  check_range("--noise", o.noise, 0.0, 1.0);
  check_range("--compression", o.compression, 0, 100);
  check_range("--tracking-error", o.tracking_error, 0.0, 100.0);
  if (o.subsurface && o.truth != HeadTruth::kPathTraced)
    throw Error("--subsurface needs path-traced truth: the other truths are of opaque surfaces.");
  if (o.subsurface && !o.head.empty())
    throw Error(
        "--subsurface is of the built-in head: how far light spreads in your own head's materials "
        "is not in its file; leave it out.");
}

// Renders the head under named lights.
class HeadStudio {
 public:
  explicit HeadStudio(const SynthHeadOptions& options) : options_(options), head_(options) {
    if (options.truth == HeadTruth::kUnshadowed) trace_.transport = Transport::kUnshadowed;
    trace_.samples = options.samples;
    trace_.bounces = options.bounces;
    trace_.seed = options.seed;
  }
  HeadScene& head() { return head_; }
  void add_light(const std::string& name_or_file) {
    Light light;
    light.image = synth_light(name_or_file);
    light.sampler = std::make_shared<EnvironmentSampler>(light.image);
    if (options_.truth == HeadTruth::kSplitSum)
      light.prefiltered = prefilter_environment(light.image);
    if (!lights_.emplace(synth_light_name(name_or_file), std::move(light)).second)
      throw Error("The light '" + synth_light_name(name_or_file) +
                  "' is named twice; give every light another name.");
  }
  const std::map<std::string, Light>& lights() const { return lights_; }
  TraceOptions& trace() { return trace_; }

  // Linear premultiplied radiance of the posed head.
  Image draw(const std::string& name) {
    const Light& light = lights_.at(name);
    head_.scene().set_environment(light.sampler);
    if (options_.truth != HeadTruth::kSplitSum) {
      samples_ += int64_t{options_.size} * options_.size * trace_.samples;
      return trace_image(head_.scene(), head_.camera(), trace_);
    }
    const int across =
        std::clamp(static_cast<int>(std::lround(std::sqrt(static_cast<double>(trace_.samples)))), 1,
                   kMostAcross);
    samples_ += int64_t{options_.size} * options_.size * across * across;
    return split_sum_image(head_.scene(), head_.camera(), light.prefiltered, across);
  }
  int64_t samples() const { return samples_; }

 private:
  SynthHeadOptions options_;
  HeadScene head_;
  TraceOptions trace_;
  std::map<std::string, Light> lights_;
  int64_t samples_ = 0;
};

class HeadCaptureWriter {
 public:
  HeadCaptureWriter(const SynthHeadOptions& options, const Path& folder)
      : options_(options), studio_(options), folder_(folder, "capture.json") {}

  SynthHeadResult run() {
    const auto begin = std::chrono::steady_clock::now();
    light_ = synth_light_name(options_.light);
    studio_.add_light(options_.light);
    for (const std::string& light : options_.relight) studio_.add_light(light);
    for (const auto& [name, light] : studio_.lights())
      write_exr(folder_.dir() / "lights" / (name + ".exr"), light.image, false);
    start_capture();
    const auto relit = relit_frames();
    const auto images =
        static_cast<int64_t>(capture_.frames.size() + relit.size() * options_.relight.size());
    Progress progress("rendering the head", "images", images);
    SynthHeadResult result;
    for (int f = 0; f < options_.frames; ++f) {
      studio_.head().pose(truth_.poses[f], f);
      render_frame(f);
      progress.update(++result.images);
      if (!relit.count(f)) continue;
      for (const std::string& light : options_.relight) {
        render_relit(f, synth_light_name(light));
        progress.update(++result.images);
      }
    }
    progress.finish();
    finish_capture();
    result.frames = options_.frames;
    result.seconds =
        std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    result.samples_per_second = static_cast<double>(studio_.samples()) / result.seconds;
    return result;
  }

 private:
  void start_capture() {
    HeadScene& head = studio_.head();
    const bool own = !options_.head.empty();
    capture_.source = own ? "the head of " + file_name(options_.head) + ", filmed by synth"
                          : "the built-in head, subject " + std::to_string(options_.subject);
    capture_.licence = own ? head.rig().licence : "Apache-2.0";
    capture_.consent = !options_.consent.empty() ? options_.consent
                       : own                     ? "not stated"
                                                 : "not a real person";
    capture_.frames_per_second = options_.frames_per_second;
    capture_.camera = head.camera();
    capture_.rig = head.rig();
    capture_.identity.assign(head.rig().identity_count, 0.0f);
    for (int f = 0; f < options_.frames; ++f) {
      CaptureFrame frame;
      frame.number = f;
      frame.seconds = f / options_.frames_per_second;
      frame.image = "images/cam0/" + file(f, ".png");
      frame.mask = "masks/cam0/" + file(f, ".png");
      if (options_.albedo_prior != "none") frame.albedo = "albedo/cam0/" + file(f, ".png");
      capture_.frames.push_back(frame);
      truth_.poses.push_back(head.performance(frame.seconds));
    }
    split_test_frames(capture_);
    capture_.poses = with_tracking_error(head.rig(), truth_.poses, options_.frames_per_second,
                                         options_.tracking_error, options_.seed);
    truth_.identity = capture_.identity;
    truth_.transport = to_string(options_.truth);
    truth_.parts = head.rig().mesh.parts;
  }

  static std::string file_name(const Path& path) {
    return (path.has_filename() ? path : path.parent_path()).filename().string();
  }

  static std::string file(int frame, const char* extension) {
    return format("{:06}{}", frame, extension);
  }

  // The held-out frames that get relighting truth, spread evenly.
  std::set<int> relit_frames() const {
    const auto test = capture_.test_frames();
    const int all = static_cast<int>(test.size());
    const int count = options_.relight_frames < 0 ? all : std::min(options_.relight_frames, all);
    std::set<int> frames;
    for (int k = 0; k < count; ++k) frames.insert(test[static_cast<size_t>(all) * k / count]);
    return frames;
  }

  void render_frame(int f) {
    const Image radiance = studio_.draw(light_);
    const CaptureFrame& frame = capture_.frames[f];
    Image shown = display_image(radiance);
    const bool defects = !frame.test;
    if (defects && options_.noise > 0)
      add_noise(shown, radiance, options_.noise, options_.seed, static_cast<uint64_t>(f));
    Image8 image = to_8bit(shown);
    if (defects && options_.compression > 0) image = compress(image, options_.compression);
    write_png8(folder_.dir() / frame.image, image, {}, true);
    write_png8(folder_.dir() / frame.mask, to_8bit(alpha_image(radiance)), {}, true);
    write_layers(f, radiance);
  }

  void write_layers(int f, const Image& radiance) {
    HeadScene& head = studio_.head();
    const SurfaceLayers layers =
        trace_layers(head.scene(), head.camera(), kLayerSamples, options_.seed);
    const Path& prior = capture_.frames[f].albedo;
    if (!prior.empty())
      write_png8(folder_.dir() / prior,
                 albedo_prior_image(layers.albedo, alpha_image(radiance), options_.albedo_prior),
                 {}, true);
    const std::vector<float>& vertices = head.scene().vertices(0);
    truth_.vertices.insert(truth_.vertices.end(), vertices.begin(), vertices.end());
    for (const float x :
         landmark_positions(head.rig().multipie, head.rig().mesh.triangles, vertices))
      truth_.keypoints.push_back(x);
    if (!options_.layers) return;
    const std::vector<float> irradiance =
        vertex_irradiance(head.scene(), 0, kIrradianceSamples, options_.seed);
    truth_.irradiance.insert(truth_.irradiance.end(), irradiance.begin(), irradiance.end());
    write_layer(f, "radiance", radiance, true);
    write_layer(f, "albedo", layers.albedo, true);
    write_layer(f, "material", layers.material, true);
    write_layer(f, "normal", planes_image(layers.gbuffer, kMappedNormal, 3), true);
    write_layer(f, "depth", planes_image(layers.gbuffer, kDepth, 1), false);
    write_layer(f, "uv", planes_image(layers.gbuffer, kUv, 2), false);
    Image8 part(radiance.width, radiance.height, 1);
    for (size_t i = 0; i < part.data.size(); ++i)
      part.data[i] = static_cast<uint8_t>(layers.part[i]);  // one mesh: part + 1
    write_png8(folder_.dir() / "layers/part" / file(f, ".png"), part, {}, true);
    truth_.layers["part"] = "layers/part";
  }

  void write_layer(int f, const std::string& name, const Image& image, bool half) {
    write_exr(folder_.dir() / "layers" / name / file(f, ".exr"), image, half);
    truth_.layers[name] = "layers/" + name;
  }

  void render_relit(int f, const std::string& light) {
    const Image radiance = studio_.draw(light);
    const std::string path = "relight/" + light + "/" + file(f, ".png");
    write_png8(folder_.dir() / path, to_8bit(display_image(radiance)), {}, true);
    if (options_.layers)
      write_exr(folder_.dir() / ("relight/" + light + "/" + file(f, ".exr")), radiance);
    relit_[light][std::to_string(capture_.frames[f].number)] = path;
  }

  void finish_capture() {
    capture_.extra = Json::object();
    for (const auto& [name, images] : relit_)
      capture_.extra["relight"][name] = {{"light", "lights/" + name + ".exr"}, {"images", images}};
    capture_.extra["light"] = "lights/" + light_ + ".exr";
    capture_.extra["made"] = {{"samples", options_.samples},
                              {"bounces", options_.bounces},
                              {"subsurface", options_.subsurface},
                              {"seed", options_.seed},
                              {"noise", options_.noise},
                              {"compression", options_.compression},
                              {"tracking_error", options_.tracking_error}};
    write_truth(truth_, capture_, folder_.dir());
    write_capture(capture_, folder_.dir());
    folder_.commit();
  }

  SynthHeadOptions options_;
  HeadStudio studio_;
  FolderWriter folder_;
  std::string light_;
  std::map<std::string, Json> relit_;
  Capture capture_;
  CaptureTruth truth_;
};

}  // namespace

HeadTruth head_truth_from_name(const std::string& name) {
  for (const HeadTruth truth :
       {HeadTruth::kSplitSum, HeadTruth::kUnshadowed, HeadTruth::kPathTraced})
    if (name == to_string(truth)) return truth;
  throw Error("There is no truth '" + name + "'; choose split-sum, unshadowed or path-traced.");
}

std::string to_string(HeadTruth truth) {
  switch (truth) {
    case HeadTruth::kSplitSum:
      return "split-sum";
    case HeadTruth::kUnshadowed:
      return "unshadowed";
    case HeadTruth::kPathTraced:
      break;
  }
  return "path-traced";
}

SynthHeadResult synth_head_capture(const SynthHeadOptions& options, const Path& folder) {
  check_options(options);
  return HeadCaptureWriter(options, folder).run();
}

std::vector<HeadNoise> synth_head_noise(const SynthHeadOptions& options, int factor, int frames) {
  check_options(options);
  EFFIGY_CHECK(factor > 1 && frames >= 1);
  HeadStudio studio(options);
  std::vector<HeadNoise> noise = {{synth_light_name(options.light)}};
  studio.add_light(options.light);
  for (const std::string& light : options.relight) {
    studio.add_light(light);
    noise.push_back({synth_light_name(light)});
  }
  for (HeadNoise& n : noise) n.least = 100;
  const TraceOptions usual = studio.trace();
  for (int k = 0; k < frames; ++k) {
    const auto frame = static_cast<int>((k + 0.5) * options.frames / frames);
    studio.head().pose(studio.head().performance(frame / options.frames_per_second), frame);
    for (HeadNoise& n : noise) {
      const Image radiance = studio.draw(n.light), matte = alpha_image(radiance);
      studio.trace().samples = usual.samples * factor;
      studio.trace().seed = usual.seed + 1;
      const Image truth = to_float(to_8bit(display_image(studio.draw(n.light))));
      studio.trace() = usual;
      const Image image = to_float(to_8bit(display_image(radiance)));
      const double all = psnr(truth, image);
      n.psnr += all / frames;
      n.least = std::min(n.least, all);
      n.foreground += psnr(truth, image, &matte) / frames;
    }
  }
  return noise;
}

}  // namespace effigy
