// effigy synth: path-traced captures with the truth of every layer.

#include <algorithm>
#include <cstdio>

#include "effigy/base/log.h"
#include "effigy/base/progress.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"
#include "effigy/cli/synth_body.h"
#include "effigy/image/files.h"
#include "effigy/synth/head_capture.h"
#include "effigy/synth/scene_file.h"
#include "effigy/synth/truth_image.h"

namespace effigy {
namespace {

struct HeadCommand {
  SynthHeadOptions options;
  std::string output, truth = "path-traced";
  bool no_relight = false, no_layers = false;
  int measure_noise = 0;
};

void add_head(CLI::App& app, HeadCommand& c) {
  SynthHeadOptions& o = c.options;
  o.frames = 120;
  o.size = 512;
  o.relight_frames = -1;
  app.add_option("-o,--output", c.output, "Capture folder")->required();
  app.add_option("--subject", o.subject, "Who: 1 to 5 are the standard subjects (default 1)")
      ->check(at_least(0));
  app.add_option("--head", o.head,
                 "Your own instead: a glTF file (.gltf, .glb) of a head or a body, with textures "
                 "and perhaps morph targets and a skeleton, or a MakeHuman folder")
      ->excludes("--subject");
  app.add_option("--consent", o.consent, "What the person agreed to, if it is a real one");
  app.add_option("--frames", o.frames, "Frames (default 120)");
  app.add_option("--size", o.size, "Pixels a side (default 512)");
  app.add_option("--fps", o.frames_per_second, "Frames a second (default 30)");
  app.add_option("--light", o.light,
                 "studio (default), overcast, sunset, window, or an EXR or HDR file");
  app.add_option("--relight", o.relight,
                 "Lights for the truth of the held-out frames (default overcast sunset window)");
  app.add_option("--relight-frames", o.relight_frames,
                 "How many held-out frames get that truth (default all)")
      ->check(at_least(1));
  app.add_flag("--no-relight", c.no_relight, "No frames under other lights");
  app.add_option("--spp", o.samples, "Samples a pixel (default 64; powers of two are best)");
  app.add_flag(
      "--subsurface", o.subsurface,
      "Light spreads below the skin and through the ears (built-in head, path-traced truth)");
  app.add_option("--bounces", o.bounces, "Reflections of a light path (default 8)");
  app.add_option("--truth", c.truth,
                 "path-traced (default), unshadowed (no shadows, no bounces), split-sum");
  app.add_option("--texture-size", o.texture_size, "Texels a side (default 1024)");
  app.add_option("--distance", o.distance, "Metres from camera to head (default 1)");
  app.add_flag("--no-layers", c.no_layers, "Only images and mattes");
  app.add_option("--albedo-prior", o.albedo_prior,
                 "Albedo images for training's prior: none (default), truth, or degraded")
      ->check(CLI::IsMember({"none", "truth", "degraded"}));
  app.add_option("--noise", o.noise,
                 "Noise of the training images: standard deviation of sRGB values, e.g. 0.01");
  app.add_option("--compression", o.compression, "JPEG quality of the training images (1..100)");
  app.add_option("--tracking-error", o.tracking_error,
                 "Error of the tracked parameters; 1: about 1 mm, half a degree, 0.03 of a shape");
  app.add_option("--measure-noise", c.measure_noise,
                 "Only print the PSNR of four frames under each light against N times the samples")
      ->check(CLI::Range(2, 1024));
}

struct SceneCommand {
  std::string scene, output;
  int samples = 0;
};

int synth_scene(const SceneCommand& c, const CommonOptions& common) {
  const Path out = c.output;
  const bool png = out.extension() == ".png";
  if (!png && out.extension() != ".exr")
    throw Error(c.output + ": the picture's name must end in .exr (linear) or .png (sRGB).");
  DescribedScene described = read_scene(c.scene);
  if (c.samples > 0) described.options.samples = c.samples;
  Progress progress("tracing", "rows", described.camera.height);
  const Image image = trace_image(described.scene, described.camera, described.options, &progress);
  progress.finish();
  if (png) {
    write_png8(out, to_8bit(display_image(image)));
  } else {
    write_exr(out, image, false);
  }
  const double rate = static_cast<double>(image.width) * image.height * described.options.samples /
                      std::max(progress.seconds(), 1e-9);
  if (common.json) {
    print_json({{"seconds", progress.seconds()}, {"samples_per_second", rate}});
  } else {
    std::printf("%s: %.2f million samples a second\n", c.output.c_str(), rate * 1e-6);
  }
  return 0;
}

void print_noise(const HeadCommand& c, const CommonOptions& common) {
  constexpr int kMoments = 4;
  const SynthHeadOptions& o = c.options;
  const std::vector<HeadNoise> noise = synth_head_noise(o, c.measure_noise, kMoments);
  if (common.json) {
    Json json = {{"psnr", noise[0].psnr}, {"samples", o.samples}};
    for (const HeadNoise& n : noise)
      json["lights"][n.light] = {
          {"psnr", n.psnr}, {"psnr_least", n.least}, {"psnr_foreground", n.foreground}};
    print_json(json);
    return;
  }
  std::printf("%d samples against %d, PSNR over %d frames\n", o.samples,
              o.samples * c.measure_noise, kMoments);
  for (const HeadNoise& n : noise)
    std::printf("  %-12s %.2f dB, least %.2f dB; over the matte %.2f dB\n", n.light.c_str(), n.psnr,
                n.least, n.foreground);
}

int synth_head(HeadCommand& c, const CommonOptions& common) {
  SynthHeadOptions& o = c.options;
  o.seed = common.seed;
  o.truth = head_truth_from_name(c.truth);
  o.layers = !c.no_layers;
  if (c.no_relight) {
    o.relight.clear();
  } else {
    // The capture's own light is not another light.
    std::erase(o.relight, o.light);
  }
  if (c.measure_noise > 0) {
    print_noise(c, common);
    return 0;
  }
  const SynthHeadResult result = synth_head_capture(o, c.output);
  if (common.json) {
    print_json({{"frames", result.frames},
                {"images", result.images},
                {"seconds", result.seconds},
                {"samples_per_second", result.samples_per_second}});
  } else {
    std::printf("%d images in %s, %.2f million samples a second\n", result.images,
                format_duration(result.seconds).c_str(), result.samples_per_second * 1e-6);
    std::printf("%s\n", c.output.c_str());
  }
  return 0;
}

}  // namespace

int run_synth(int argc, char** argv) {
  CLI::App app(
      "Makes captures with known answers by path tracing: a talking head under any light, its\n"
      "held-out frames under other lights, or a clothed body in a light stage, with the truth of\n"
      "every layer (docs/synth.md). Built-in people, or your own. An interrupted body capture goes "
      "on\n"
      "when the command is given again.\n\n"
      "example: effigy synth head -o capture --frames 64 --size 256 --light sunset\n"
      "example: effigy synth head -o capture --head me.glb\n"
      "example: effigy synth body -o stage --stage tiny",
      "synth");
  app.require_subcommand(1);
  CommonOptions common;
  HeadCommand head;
  CLI::App* head_app = app.add_subcommand("head", "a talking head seen by one camera");
  add_head(*head_app, head);
  add_common(*head_app, common, true, true);
  BodyCommand body;
  CLI::App* body_app =
      app.add_subcommand("body", "a clothed body in a light stage, seen by many cameras");
  add_synth_body(*body_app, body);
  add_common(*body_app, common, true, true);
  SceneCommand scene;
  CLI::App* scene_app =
      app.add_subcommand("scene", "one picture of a described scene (docs/synth.md)");
  scene_app->add_option("SCENE", scene.scene, "JSON description")->required();
  scene_app->add_option("-o,--output", scene.output, "Picture: .exr (linear) or .png")->required();
  scene_app->add_option("--spp", scene.samples, "Samples a pixel (default: as described)")
      ->check(at_least(1));
  add_common(*scene_app, common, false, true);
  if (!parse_command_line(app, argc, argv, common)) return 0;
  if (body_app->parsed()) return synth_body(body, common);
  return head_app->parsed() ? synth_head(head, common) : synth_scene(scene, common);
}

}  // namespace effigy
