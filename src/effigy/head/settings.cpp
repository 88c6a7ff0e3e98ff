#include "effigy/head/settings.h"

#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/settings.h"

namespace effigy {
namespace {

// The one list that reading and writing share (base/settings.h).
constexpr auto kList = [](auto& s, auto&& visit) {
  visit("preset", s.preset);
  visit("paper_literal", s.paper_literal);
  visit("iterations", s.iterations);
  visit("surfels", s.surfels);
  visit("texture_size", s.texture_size);
  visit("rate.barycentric", s.rates.barycentric);
  visit("rate.rotation", s.rates.rotation);
  visit("rate.log_scale", s.rates.log_scale);
  visit("rate.displacement", s.rates.displacement);
  visit("rate.opacity", s.rates.opacity);
  visit("rate.material", s.rates.material);
  visit("rate.normal", s.rates.normal);
  visit("rate.environment", s.rates.environment);
  visit("rate.template_vertices", s.rates.template_vertices);
  visit("rate.weights", s.rates.weights);
  visit("rate.basis", s.rates.basis);
  visit("rate.frame_expression", s.rates.frame_expression);
  visit("rate.frame_rotation", s.rates.frame_rotation);
  visit("rate.frame_translation", s.rates.frame_translation);
  visit("rate.encoder", s.rates.encoder);
  visit("weight.l1", s.weights.l1);
  visit("weight.dssim", s.weights.dssim);
  visit("weight.mask", s.weights.mask);
  visit("weight.albedo_prior", s.weights.albedo_prior);
  visit("weight.smooth", s.weights.smooth);
  visit("weight.normal_map", s.weights.normal_map);
  visit("weight.normal_consistency", s.weights.normal_consistency);
  visit("weight.uv_distortion", s.weights.uv_distortion);
  visit("weight.boundary", s.weights.boundary);
  visit("weight.barycentric", s.weights.barycentric);
  visit("weight.laplacian", s.weights.laplacian);
  visit("weight.rig", s.weights.rig);
  visit("weight.expression", s.weights.expression);
  visit("weight.material_prior", s.weights.material_prior);
  visit("uv_distortion", s.uv_distortion);
  visit("uv_distortion_start", s.uv_distortion_start);
  visit("uv_distortion_threshold", s.uv_distortion_threshold);
  visit("largest_scale", s.largest_scale);
  visit("divide_by_alpha", s.divide_by_alpha);
  visit("interpolated_normals", s.interpolated_normals);
  visit("splat_normal_frame", s.splat_normal_frame);
  visit("jacobian_to_vertices", s.jacobian_to_vertices);
  visit("fit_silhouette", s.fit_silhouette);
  visit("start_from_frames", s.start_from_frames);
  visit("start_light", s.start_light);
  visit("refine_expression", s.refine_expression);
  visit("refine_pose", s.refine_pose);
  visit("encoder", s.encoder);
  visit("encoder_head_pose", s.encoder_head_pose);
  visit("encoder_codes", s.encoder_codes);
  visit("encoder_reach", s.encoder_reach);
  visit("hold_mean_pose", s.hold_mean_pose);
  visit("refine_rig", s.refine_rig);
  visit("local_rig", s.local_rig);
  visit("restore_unseen", s.restore_unseen);
  visit("final_rate_factor", s.final_rate_factor);
  visit("final_part", s.final_part);
  visit("evaluate_every", s.evaluate_every);
  visit("checkpoint_every", s.checkpoint_every);
  visit("seed", s.seed);
};

void check(const TrainSettings& s, const std::string& name) {
  auto require = [&](bool good, const char* what) {
    if (!good) throw Error(name + ": " + what + ".");
  };
  require(s.iterations >= 1 && s.iterations <= 10'000'000, "iterations must be 1 to 10000000");
  require(s.surfels >= 100 && s.surfels <= 1'000'000, "surfels must be 100 to 1000000");
  require(s.texture_size >= 64 && s.texture_size <= 4096, "texture_size must be 64 to 4096");
  require(s.uv_distortion == "norm" || s.uv_distortion == "squared" || s.uv_distortion == "off",
          "uv_distortion must be norm, squared or off");
  require(s.largest_scale > 0, "largest_scale must be positive");
  require(s.encoder_codes >= 1 && s.encoder_codes <= 1000, "encoder_codes must be 1 to 1000");
  require(s.encoder_reach > 0 && s.encoder_reach <= 30, "encoder_reach must be in (0, 30]");
  require(s.final_part >= 0 && s.final_part <= 1 && s.final_rate_factor > 0,
          "final_part must be in [0, 1] and final_rate_factor positive");
}

}  // namespace

namespace {

// Tables 3a and 3b.
void set_paper_rig(TrainSettings& s) {
  s.rates.template_vertices = 1e-5;
  s.rates.weights = 1e-4;
  s.rates.basis = 1e-6;
  s.weights.laplacian = 3200;
}

}  // namespace

TrainSettings TrainSettings::from_preset(const std::string& name) {
  TrainSettings s;
  s.preset = name;
  if (name == "quick") {
    s.iterations = 1500;
    s.uv_distortion_start = 500;
  } else if (name == "standard") {
    s.iterations = 6000;
  } else if (name == "paper") {
    s.iterations = 60000;
    s.surfels = 41472;
    set_paper_rig(s);
  } else {
    throw Error("--preset must be quick, standard or paper, not '" + name + "'.");
  }
  return s;
}

void TrainSettings::make_paper_literal() {
  paper_literal = true;
  uv_distortion = "norm";
  uv_distortion_start = 0;
  uv_distortion_threshold = 0;
  divide_by_alpha = false;
  interpolated_normals = false;
  splat_normal_frame = true;
  jacobian_to_vertices = false;
  refine_pose = false;
  fit_silhouette = false;
  start_from_frames = false;
  start_light = false;
  restore_unseen = false;
  hold_mean_pose = false;
  local_rig = false;
  final_rate_factor = 1;
  set_paper_rig(*this);
  weights.material_prior = 0;
  rates.environment = 2e-2;
  weights.dssim = 0.2;
}

Json to_json(const TrainSettings& settings) {
  return settings_to_json(settings, kList);
}

void from_json_checked(const Json& json, const std::string& name, TrainSettings& settings) {
  settings_from_json(json, name, "docs/training.md", settings, kList);
  check(settings, name);
}

}  // namespace effigy
