// Internals of HeadTrainer: what one iteration reads and writes.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "effigy/base/random.h"
#include "effigy/geometry/laplacian.h"
#include "effigy/head/trainer.h"
#include "effigy/learn/adam.h"
#include "effigy/learn/texture_losses.h"
#include "effigy/light/environment.h"
#include "effigy/shade/deferred.h"

namespace effigy {

// Optimiser states of the whole-run parameters, by the names used in checkpoints.
struct HeadOptimiser {
  AdamState barycentric, displacement, rotation, log_scale, opacity;
  AdamState environment, rest, weights, expression_basis, pose_basis, encoder;
  std::vector<AdamState> poses;  // per frame of the capture; empty until first used

  // Calls visit(name, state) for every whole-run state.
  template <typename Visit>
  void visit(Visit&& each) {
    each("barycentric", barycentric);
    each("displacement", displacement);
    each("rotation", rotation);
    each("log_scale", log_scale);
    each("opacity", opacity);
    each("environment", environment);
    each("rest", rest);
    each("weights", weights);
    each("expression_basis", expression_basis);
    each("pose_basis", pose_basis);
    each("encoder", encoder);
  }
};

struct HeadTrainer::State {
  State(const Capture& capture_in, const TrainSettings& settings_in);

  const Capture& capture;
  TrainSettings settings;
  HeadModel model;
  HeadOptimiser optimiser;
  FrameStore store;
  std::vector<int> frames;  // training frames, in the order of this epoch
  size_t next = 0;          // position in `frames`
  int64_t epoch = 0, iteration = 0;

  // Fixed for the run.
  Prefilter prefilter{kEnvironmentSize};
  UniformLaplacian laplacian;
  UvMask mask;
  std::vector<std::vector<float>> codes;  // of training frames, what the encoder sees
  std::vector<uint8_t> encoded;           // entries of a pose that the encoder corrects
  std::vector<uint8_t> shared;            // per vertex of the rig: several joints move it
  TextureActivation activation;
  ShadeOptions shade;
  BindOptions bind;

  // Scratch of one iteration, kept to keep its memory.
  TargetFrame target;
  MaterialTexture texture;
  std::vector<float> vertices, original_vertices, scratch;
  PosedSurfels posed, d_posed;
  SurfelFrame raster;
  Planes gbuffer, colour, d_gbuffer, d_colour;
  std::vector<float> d_texels;
  BoundSurfelGradients d_bound;

  int next_frame();
  void shuffle_frames();
  void hold_mean_pose();
  LossValues step();
  double rate_factor() const;
  SurfelRasterOptions raster_options() const;
  void draw(const RigPose& pose, const PrefilteredEnvironment& light);
  void image_losses(LossValues& losses);
  void surfel_losses(LossValues& losses);
  void update_surfels();
  void update_environment(const PrefilteredEnvironment& d_light);
  void update_material(LossValues& losses);
  int group_of(size_t entry) const;
  // What a training frame is drawn with: as refined, and as the encoder corrects it.
  RigPose pose_of(int frame) const;
  void update_rig(int frame, const RigPose& pose, LossValues& losses);
  void update_pose(int frame, const RigPose& pose, const RigGradient& gradient, LossValues& losses);
  void update_encoder(int frame, const std::vector<float>& d_pose);
};

}  // namespace effigy
