// Training settings of body avatars: every number that shapes a run, with the presets. Saved in
// avatar.json and training.json, so that each result knows how it was made.
#pragma once

#include <cstdint>
#include <string>

#include "effigy/base/json.h"

namespace effigy {

struct BodyDrawOptions;

// Adam step sizes.
struct BodyRates {
  double networks = 1e-3;  // Relightable Full-Body Gaussian Codec Avatars, section 3.4
  double maps = 1e-2;      // albedo, and logarithm of roughness
  double cameras = 1e-3;   // gains and offsets
};

// Weights of the losses (Eq. 17-18 and appendix B; the image's in display encoding).
struct BodyWeights {
  double l1 = 1, dssim = 0.2;
  double pyramid = 0.5;  // L1 over the bands of a Laplacian pyramid; not in the paper
  // The perceptual term, when there is one: of LPIPS (Eq. 17), or of SqueezeNet's features, whose
  // distances are about ten times as large.
  double lpips = 0.1, features = 0.01;
  double scale = 1;      // mean |s|, metres
  double offset = 0.05;  // mean |delta t|^2, centimetres squared
  double mask = 0.1;
  double normal = 1;           // mean |delta n|^2, falls to 0 over normal_anneal
  double bound = 0.01;         // scales and roughness within bounds
  double normal_orient = 0.1;  // normals that look away from the camera
  double alpha_sparsity = 0.1;
  double albedo = 0.01;     // mean |albedo|
  double transfer = 0.05;   // mean square of what is learned of transfer; not in the paper
  double dark_lobes = 1;    // mean square of negative diffuse transfer of one random light; not in
                            // the paper
  double neg_color = 0.01;  // mean square of negative diffuse colours and albedos
};

struct BodyTrainSettings {
  std::string preset = "standard";
  bool paper_literal = false;
  std::string size = "small";  // of the networks: tiny, small, full
  int iterations = 30000;
  int batch = 1;  // views a step
  int crop = 0;   // side of a random crop in pixels; 0: all that shows the body
  BodyRates rates;
  BodyWeights weights;
  double normal_anneal = 0.5;      // share of the run (the paper: 20 of 300 thousand)
  double final_rate_factor = 0.1;  // rates fall to this over the last part of the run; 1: constant
  double final_part = 0.5;         // that part
  double clip_gradient = 1;        // largest norm of the networks' gradient; 0: none
  double explosion = 10;  // a loss this many times the mean of the last 32 goes back; 0: none
  // Bounds of appendix B, metres and radians.
  double scale_low = 1e-4, scale_high = 1e-2, roughness_low = 0.01, roughness_high = 0.25;
  std::string bound = "relative";      // below a bound: "relative" low / v, or "paper" 1 / v
  std::string alpha_sparsity = "min";  // min(a, 1 - a), or "log"
  int mask_border = 2;                 // pixels around the mask's edge without mask loss
  bool compensate = true;              // small Gaussians' opacity for the blur (splat/)
  bool divide_by_alpha = true;         // blended channels before they are used (body/draw.h)
  std::string sg_norm = "code";        // code, pi32, unit (light/spherical_gaussian.h)
  // Network of the perceptual term: "none", LPIPS by "vgg", "alex" or "squeeze", or "squeezenet10"
  // (infer/perceptual.h).
  std::string perceptual = "none";
  bool deferred = true;  // specular light per pixel; else per Gaussian
  bool shadow = true;    // the shadow network
  // Or the paper's baselines "sh" and "pbr", or "sh_turned" (body/draw.h).
  std::string appearance = "zonal";
  std::string normals = "gaussian";  // of specular light: "gaussian" (Eq. 10) or "mesh"
  int shadow_samples = 16;           // rays a texel for irradiance
  // Groups of lights that have shadows of their own (light/light_groups.h); the paper has one
  // shadow for all, which loses that light adds up.
  int shadow_groups = 1;
  int environment_from = 65;  // lights from which a frame counts as lit by an environment
  // Diffuse light of environments: "polynomials" of its harmonics, or a "table" of their bands.
  std::string environment_bands = "polynomials";
  bool backgrounds = true;   // fully lit frames over the cameras' background photographs, if any
  bool falloff = true;       // light falls with the distance's square
  bool camera_gains = true;  // a gain and an offset per camera, the first one fixed
  bool start_from_frames = true;  // albedo from the frames' colours; else 0.5
  int evaluate_every = 1000;      // held-out PSNR in the progress line; 0: never
  int checkpoint_every = 500;
  uint64_t seed = 1;

  // quick (tiny), standard (small), paper (full). Throws Error for another name.
  static BodyTrainSettings from_preset(const std::string& name);
  // Sets every setting of docs/decisions.md to the paper's side.
  void make_paper_literal();
};

// How what they train is drawn.
BodyDrawOptions draw_options(const BodyTrainSettings& settings);

Json to_json(const BodyTrainSettings& settings);
// Unknown fields are an error; missing ones keep their value in `settings`.
void from_json_checked(const Json& json, const std::string& name, BodyTrainSettings& settings);

}  // namespace effigy
