// Internals of BodyTrainer: what one iteration reads and writes.
#pragma once

#include <array>
#include <deque>
#include <optional>
#include <vector>

#include "effigy/body/stage_views.h"
#include "effigy/body/trainer.h"
#include "effigy/learn/adam.h"

namespace effigy {

struct BodyTrainer::State {
  State(const StageCapture& capture_in, const BodyTrainSettings& settings_in,
        PictureDistance perceptual_in, Ranks& ranks_in);

  const StageCapture& capture;
  StageSource source;
  BodyTrainSettings settings;
  Ranks& ranks;
  BodyModel model;
  StageMoments moments;
  BodyDrawOptions options;
  PictureDistance perceptual;
  std::vector<int> frames, cameras;  // of training
  std::vector<CameraColour> colours;

  std::vector<AdamState> networks;  // in the order of BodyNetworks::parameters()
  AdamState albedo, roughness;
  std::vector<AdamState> colour_states;
  int64_t iteration = 0, order = 0;  // order: changed after an explosion
  std::deque<float> recent;

  // Of one step.
  StageView view;
  BodyTarget target;
  BodyPicture picture;
  BodyImageGradients d_image;
  BodySurfaceGradients d_surface;
  BodyMaps d_maps;
  std::vector<float> d_decoded, d_diffuse, scaled;
  std::vector<std::array<double, 6>> d_colours;
  std::vector<std::vector<float>> sums;  // this process's parts of the gradients

  std::optional<StageViews> views;  // decoded ahead
  double rate_factor() const;
  double normal_weight() const;
  double total(const BodyLossValues& values) const;
  // Views from this one of the present order on; of many processes each has every so-manieth.
  void go_to(uint64_t number);
  // The first view of the next step.
  uint64_t next_number() const { return views->number() - static_cast<uint64_t>(ranks.rank()); }
  void clear_gradients();
  void draw_view(BodyLossValues& mean);
  // What draw_view adds for all views of the batch, on all processes, in the order of the views.
  void draw_batch_together(BodyLossValues& mean);
  // The gradients of networks and maps, in a fixed order; those there are.
  std::vector<std::span<float>> gradients();
  void update_networks();
  void update_maps();
  void update_colours();
  // What a new model needs to know before it is trained.
  void prepare_model();
  BodyLossValues step();
};

}  // namespace effigy
