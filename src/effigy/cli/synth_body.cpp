#include "effigy/cli/synth_body.h"

#include <cstdio>

#include "effigy/base/log.h"
#include "effigy/base/progress.h"

namespace effigy {
namespace {

StageOptions stage_from(const BodyCommand& c, const CommonOptions& common) {
  StageOptions stage = stage_preset(c.stage);
  const auto take = [](const auto& given, auto& value) {
    if (given) value = *given;
  };
  take(c.cameras, stage.cameras);
  take(c.lights, stage.lights);
  take(c.frames, stage.frames);
  take(c.unseen_frames, stage.unseen_frames);
  take(c.radius, stage.radius);
  take(c.frames_per_second, stage.frames_per_second);
  if (!c.size.empty()) {
    stage.width = c.size[0];
    stage.height_pixels = c.size.back();
  }
  stage.light_file = c.light_file;
  stage.light_up = up_axis_from_name(c.light_up);
  stage.lighting = stage_lighting_from_name(c.lighting);
  if (!c.framing.empty()) stage.framing = stage_framing_from_name(c.framing);
  stage.seed = common.seed;
  return stage;
}

std::string bytes_text(int64_t bytes) {
  const double gib = static_cast<double>(bytes) / (1 << 30);
  return gib >= 1000 ? format("{:.1f} TiB", gib / 1024)
         : gib >= 1  ? format("{:.1f} GiB", gib)
                     : format("{:.0f} MiB", gib * 1024);
}

std::string time_text(double seconds) {
  constexpr double kDay = 86400;
  return seconds < 2 * kDay ? format_duration(seconds) : format("{:.0f} days", seconds / kDay);
}

void print_plan(const BodyCommand& c, bool json) {
  const SynthBodyPlan p = plan_body_capture(c.options);
  const StageOptions& s = c.options.stage;
  if (json) {
    print_json({{"cameras", p.cameras},
                {"test_cameras", p.test_cameras},
                {"lights", p.lights},
                {"radius", s.radius},
                {"size", {s.width, s.height_pixels}},
                {"frames", p.frames},
                {"train_frames", p.train},
                {"test_lights_frames", p.held_out_lights},
                {"test_motion_frames", p.unseen},
                {"test_environment_frames", p.relit},
                {"fully_lit_frames", p.fully_lit},
                {"images", p.images},
                {"samples", p.samples},
                {"bytes", p.bytes},
                {"seconds", p.seconds}});
    return;
  }
  std::printf("cameras   %d, of which %d held out, %.2f m from the middle, %d x %d pixels\n",
              p.cameras, p.test_cameras, s.radius, s.width, s.height_pixels);
  std::printf("lights    %d\n", p.lights);
  std::printf(
      "frames    %d: %d to train on, %d with held-out lights, %d of unseen motion, "
      "%d under environments; %d fully lit\n",
      p.frames, p.train, p.held_out_lights, p.unseen, p.relit, p.fully_lit);
  std::printf("images    %lld, %.3g samples\n", static_cast<long long>(p.images),
              static_cast<double>(p.samples));
  std::printf("disk      about %s\n", bytes_text(p.bytes).c_str());
  std::printf("time      about %s on this machine\n", time_text(p.seconds).c_str());
}

}  // namespace

void add_synth_body(CLI::App& app, BodyCommand& c) {
  SynthBodyOptions& o = c.options;
  app.add_option("-o,--output", c.output, "Capture folder");
  app.add_option("--subject", o.subject, "Who: 1 to 5 are the standard subjects (default 1)")
      ->check(at_least(0));
  app.add_option(
      "--body", o.body,
      "Your own instead: a skinned glTF file or a MakeHuman folder; without --motion it sways");
  app.add_option("--stage", c.stage,
                 "tiny (8 cameras, 64 lights, 40 frames of 256 pixels), small (default: 16, 128, "
                 "64 of 512) or paper (512, 1024, 5500 of 1152 x 1332)");
  app.add_option("--cameras", c.cameras, "Cameras on the dome, a fifth of them held out");
  app.add_option("--lights", c.lights, "Lights on the dome");
  app.add_option("--light-positions", c.light_file,
                 "Positions of the lights instead: .npy [N, 3] or three numbers a line");
  app.add_option("--light-up", c.light_up,
                 "Axis of that file that points up: auto (default: +y, or -y when lights stand all "
                 "around but for an opening at +y), +y, -y, +z, -z, +x, -x");
  app.add_option("--radius", c.radius, "Of the dome, metres (default 2.75)");
  app.add_option("--frames", c.frames, "Frames in all");
  app.add_option("--unseen-frames", c.unseen_frames,
                 "Of them, of unseen motion (default an eighth)")
      ->check(at_least(0));
  app.add_option("--fps", c.frames_per_second, "Frames a second (default 5)");
  app.add_option("--size", c.size, "Pixels: a side, or width and height")->expected(1, 2);
  app.add_option("--framing", c.framing,
                 "What fills the pictures: person (default: where the person moves) or dome "
                 "(default of the paper's stage: 1.1 metres around the dome's middle)");
  app.add_option("--lighting", c.lighting,
                 "mixed (default: every third frame all lights, the others 10 to 20), full, "
                 "groups, single, environment");
  app.add_option("--light", o.environment,
                 "Of lighting environment: studio (default), overcast, sunset, window, or an EXR "
                 "or HDR file");
  app.add_option("--relight", o.relight,
                 "Lights under which moments of the unseen motion are seen again");
  app.add_option("--relight-frames", o.relight_frames, "How many moments (default 2)")
      ->check(at_least(1));
  app.add_option("--motion", o.motion, "BVH file of the training motion (default built-in)");
  app.add_option("--unseen-motion", o.unseen_motion, "BVH file of the unseen motion");
  app.add_option("--mesh", c.mesh,
                 "Mesh handed to training: tracked (default, without the cloth's wrinkles) or true")
      ->check(CLI::IsMember({"tracked", "true"}));
  app.add_option("--tracking-error", o.tracking_error,
                 "Error of the tracked parameters; 1: about 1 mm, half a degree, 0.03 of a shape");
  app.add_option("--spp", o.samples, "Samples a pixel (default 64; powers of two are best)");
  app.add_option("--bounces", o.bounces, "Reflections of a light path (default 4)");
  app.add_option("--texture-size", o.texture_size, "Texels a side (default 1024)");
  app.add_flag("--no-subsurface", c.no_subsurface, "Opaque skin");
  app.add_flag("--no-layers", c.no_layers, "Only images, mattes and meshes");
  app.add_flag("--plan", c.plan, "Makes nothing: prints sizes, disk space and time");
}

int synth_body(BodyCommand& c, const CommonOptions& common) {
  SynthBodyOptions& o = c.options;
  o.stage = stage_from(c, common);
  o.true_mesh = c.mesh == "true";
  o.layers = !c.no_layers;
  o.subsurface = !c.no_subsurface;
  if (c.plan) {
    print_plan(c, common.json);
    return 0;
  }
  if (c.output.empty()) throw Error("synth body needs -o FOLDER, or --plan to make nothing.");
  const SynthBodyResult result = synth_body_capture(o, c.output);
  if (common.json) {
    print_json({{"frames", result.frames},
                {"images", result.images},
                {"kept", result.kept},
                {"seconds", result.seconds}});
  } else {
    std::printf("%d images of %d frames in %s\n", result.images, result.frames,
                format_duration(result.seconds).c_str());
    std::printf("%s\n", c.output.c_str());
  }
  return 0;
}

}  // namespace effigy
