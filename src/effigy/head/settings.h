// Training settings of head avatars: every number that shapes a run, with the presets. Saved in
// avatar.json and training.json, so that each result knows how it was made.
#pragma once

#include <string>

#include "effigy/base/json.h"

namespace effigy {

// Adam step sizes (GTAvatar Table 3a, in our units: metres, radians, natural logs, logits).
struct LearningRates {
  double barycentric = 1e-3;
  double rotation = 1e-3;  // quaternion components
  double log_scale = 5e-3;
  double displacement = 5e-6;  // metres (Table 3a's 2e-5 belongs to a rig scaled by 4)
  double opacity = 5e-2;       // logit
  double material = 5e-3;      // texture logits
  double normal = 1e-3;        // texture atanh
  double environment = 5e-2;   // log radiance (Table 3a: 2e-2)
  // The rig's (the paper's 1e-5, 1e-4 and 1e-6 are for runs five to fifteen times as long).
  double template_vertices = 3e-4;  // metres
  double weights = 2e-3;
  double basis = 2e-5;  // metres per unit: expression and pose bases
  double frame_expression = 2e-3;
  double frame_rotation = 2e-4;     // radians
  double frame_translation = 2e-5;  // metres
  double encoder = 1e-4;  // expression per unit of code; 0.1 of it in radians, 0.01 in metres
};

// Weights of the losses (Table 3b with decisions in metres).
struct LossWeights {
  double l1 = 0.80, dssim = 0.50, mask = 0.10;  // dssim: Table 3b 0.20
  double albedo_prior = 0.25;                   // only frames that have a prior image
  double smooth = 0.01;                         // TV of roughness and F0
  double normal_map = 0.01;                     // L1 to the flat normal
  double normal_consistency = 0.05;
  double uv_distortion = 50;
  double boundary = 1;
  double barycentric = 0.1;
  double laplacian = 12800;
  double rig = 0.001;
  double expression = 0.01;
  double material_prior = 0.05;  // roughness towards 0.5, F0 towards 0.05 (squared)
};

struct TrainSettings {
  std::string preset = "standard";
  bool paper_literal = false;
  int iterations = 12000;
  int surfels = 10000;
  int texture_size = 1024;
  LearningRates rates;
  LossWeights weights;
  std::string uv_distortion = "norm";     // "norm" (paper), "squared", "off"
  int uv_distortion_start = 2000;         // iteration
  double uv_distortion_threshold = 0.05;  // in [0, 1] UV; 0: none
  double largest_scale = 0.02;            // metres, of a surfel's standard deviation
  bool divide_by_alpha = true;            // G-buffer divided by alpha before shading
  bool interpolated_normals = false;
  bool splat_normal_frame = false;  // Eq. 7's frame instead of the UV-aligned one
  bool jacobian_to_vertices = false;
  bool fit_silhouette = true;      // start at the mattes' outline (head/silhouette.h)
  bool start_from_frames = true;   // start albedo and light from the frames (head/start_texture.h)
  bool start_light = true;         // and that light from how brightness goes with the normal
  bool refine_expression = true;   // per training frame
  bool refine_pose = true;         // per training frame (rotation, neck, eyes, translation)
  bool encoder = true;             // learn to correct the tracking (avatar/frame_encoder.h)
  bool encoder_head_pose = false;  // its rotations and translations too, not the expression alone
  int encoder_codes = 24;          // in how many ways the inputs differ, for the encoder
  double encoder_reach = 3;        // standard deviations beyond which they count no more
  bool hold_mean_pose = true;      // what all frames' refinements share is taken back each epoch
  bool refine_rig = true;          // template, bases, weights
  bool local_rig = true;       // joints, and shapes in the neck, move only what they moved before
  bool restore_unseen = true;  // what no training frame shows, at the end (head/unseen.h)
  double final_rate_factor = 0.1;  // rates in the last part of the run, 1: constant
  double final_part = 0.5;         // that part, as a share of the iterations
  int evaluate_every = 1000;       // held-out PSNR in the progress line; 0: never
  int checkpoint_every = 500;
  uint64_t seed = 1;

  // quick, standard, paper. Throws Error for another name.
  static TrainSettings from_preset(const std::string& name);
  // Sets every setting of docs/decisions.md to the paper's side.
  void make_paper_literal();
};

Json to_json(const TrainSettings& settings);
// Unknown fields are an error (a misspelt setting must not be ignored); missing ones keep their
// value in `settings`.
void from_json_checked(const Json& json, const std::string& name, TrainSettings& settings);

}  // namespace effigy
