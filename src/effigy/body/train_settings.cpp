#include "effigy/body/train_settings.h"

#include "effigy/base/error.h"
#include "effigy/base/settings.h"
#include "effigy/body/draw.h"

namespace effigy {
namespace {

// The one list that reading and writing share (base/settings.h).
constexpr auto kList = [](auto& s, auto&& visit) {
  visit("preset", s.preset);
  visit("paper_literal", s.paper_literal);
  visit("size", s.size);
  visit("iterations", s.iterations);
  visit("batch", s.batch);
  visit("crop", s.crop);
  visit("rate.networks", s.rates.networks);
  visit("rate.maps", s.rates.maps);
  visit("rate.cameras", s.rates.cameras);
  visit("weight.l1", s.weights.l1);
  visit("weight.dssim", s.weights.dssim);
  visit("weight.pyramid", s.weights.pyramid);
  visit("weight.lpips", s.weights.lpips);
  visit("weight.features", s.weights.features);
  visit("weight.scale", s.weights.scale);
  visit("weight.offset", s.weights.offset);
  visit("weight.mask", s.weights.mask);
  visit("weight.normal", s.weights.normal);
  visit("weight.bound", s.weights.bound);
  visit("weight.normal_orient", s.weights.normal_orient);
  visit("weight.alpha_sparsity", s.weights.alpha_sparsity);
  visit("weight.albedo", s.weights.albedo);
  visit("weight.transfer", s.weights.transfer);
  visit("weight.dark_lobes", s.weights.dark_lobes);
  visit("weight.neg_color", s.weights.neg_color);
  visit("normal_anneal", s.normal_anneal);
  visit("final_rate_factor", s.final_rate_factor);
  visit("final_part", s.final_part);
  visit("clip_gradient", s.clip_gradient);
  visit("explosion", s.explosion);
  visit("scale_low", s.scale_low);
  visit("scale_high", s.scale_high);
  visit("roughness_low", s.roughness_low);
  visit("roughness_high", s.roughness_high);
  visit("bound", s.bound);
  visit("alpha_sparsity", s.alpha_sparsity);
  visit("mask_border", s.mask_border);
  visit("compensate", s.compensate);
  visit("divide_by_alpha", s.divide_by_alpha);
  visit("sg_norm", s.sg_norm);
  visit("perceptual", s.perceptual);
  visit("deferred", s.deferred);
  visit("shadow", s.shadow);
  visit("appearance", s.appearance);
  visit("normals", s.normals);
  visit("shadow_samples", s.shadow_samples);
  visit("shadow_groups", s.shadow_groups);
  visit("environment_bands", s.environment_bands);
  visit("backgrounds", s.backgrounds);
  visit("environment_from", s.environment_from);
  visit("falloff", s.falloff);
  visit("camera_gains", s.camera_gains);
  visit("start_from_frames", s.start_from_frames);
  visit("evaluate_every", s.evaluate_every);
  visit("checkpoint_every", s.checkpoint_every);
  visit("seed", s.seed);
};

void check(const BodyTrainSettings& s, const std::string& name) {
  const auto require = [&](bool good, const char* what) {
    if (!good) throw Error(name + ": " + what + ".");
  };
  require(s.size == "tiny" || s.size == "small" || s.size == "full",
          "size must be tiny, small or full");
  require(s.iterations >= 1 && s.iterations <= 10'000'000, "iterations must be 1 to 10000000");
  require(s.batch >= 1 && s.batch <= 1024, "batch must be 1 to 1024");
  require(s.crop == 0 || (s.crop >= 32 && s.crop <= 8192), "crop must be 0 or 32 to 8192");
  require(s.final_part >= 0 && s.final_part <= 1 && s.final_rate_factor > 0,
          "final_part must be in [0, 1] and final_rate_factor positive");
  require(s.normal_anneal >= 0 && s.normal_anneal <= 1, "normal_anneal must be in [0, 1]");
  require(s.clip_gradient >= 0 && s.explosion >= 0,
          "clip_gradient and explosion must not be negative");
  require(s.scale_low > 0 && s.scale_low < s.scale_high && s.roughness_low > 0 &&
              s.roughness_low < s.roughness_high,
          "bounds must be positive, the lower below the higher");
  require(s.bound == "relative" || s.bound == "paper", "bound must be relative or paper");
  require(s.alpha_sparsity == "min" || s.alpha_sparsity == "log",
          "alpha_sparsity must be min or log");
  require(s.mask_border >= 0 && s.mask_border <= 64, "mask_border must be 0 to 64");
  require(s.sg_norm == "code" || s.sg_norm == "pi32" || s.sg_norm == "unit",
          "sg_norm must be code, pi32 or unit");
  require(s.perceptual == "none" || s.perceptual == "vgg" || s.perceptual == "alex" ||
              s.perceptual == "squeeze" || s.perceptual == "squeezenet10",
          "perceptual must be none, vgg, alex, squeeze or squeezenet10");
  require(s.appearance == "zonal" || s.appearance == "sh" || s.appearance == "sh_turned" ||
              s.appearance == "pbr",
          "appearance must be zonal, sh, sh_turned or pbr");
  require(s.appearance != "pbr" || s.deferred, "appearance pbr is deferred; leave deferred true");
  require(s.normals == "gaussian" || s.normals == "mesh", "normals must be gaussian or mesh");
  require(s.shadow_samples >= 1 && s.shadow_samples <= 65536, "shadow_samples must be 1 to 65536");
  require(s.shadow_groups >= 1 && s.shadow_groups <= 32, "shadow_groups must be 1 to 32");
  require(s.environment_bands == "polynomials" || s.environment_bands == "table",
          "environment_bands must be polynomials or table");
  require(s.environment_from >= 1, "environment_from must be at least 1");
  require(s.evaluate_every >= 0 && s.checkpoint_every >= 1,
          "evaluate_every must not be negative and checkpoint_every at least 1");
}

}  // namespace

BodyTrainSettings BodyTrainSettings::from_preset(const std::string& name) {
  BodyTrainSettings s;
  s.preset = name;
  if (name == "quick") {
    s.size = "tiny";
    s.iterations = 8000;
  } else if (name == "paper") {
    s.size = "full";
    s.iterations = 300'000;
    s.batch = 4;
  } else if (name != "standard") {
    throw Error("--preset must be quick, standard or paper, not '" + name + "'.");
  }
  return s;
}

void BodyTrainSettings::make_paper_literal() {
  paper_literal = true;
  weights.pyramid = 0;
  weights.transfer = 0;
  weights.dark_lobes = 0;
  bound = "paper";
  compensate = false;
  divide_by_alpha = false;
  normal_anneal = 0.067;
  sg_norm = "code";
  environment_from = 100'000;
  backgrounds = false;
  camera_gains = false;
  clip_gradient = 0;
  explosion = 0;
  final_rate_factor = 1;
  start_from_frames = false;
}

BodyDrawOptions draw_options(const BodyTrainSettings& settings) {
  BodyDrawOptions options;
  options.appearance = body_appearance_named(settings.appearance);
  options.deferred = settings.deferred;
  options.divide_by_alpha = settings.divide_by_alpha;
  options.raster.compensate = settings.compensate;
  options.sg_norm = sg_norm_named(settings.sg_norm.c_str());
  return options;
}

Json to_json(const BodyTrainSettings& settings) {
  return settings_to_json(settings, kList);
}

void from_json_checked(const Json& json, const std::string& name, BodyTrainSettings& settings) {
  settings_from_json(json, name, "docs/body-training.md", settings, kList);
  check(settings, name);
}

}  // namespace effigy
