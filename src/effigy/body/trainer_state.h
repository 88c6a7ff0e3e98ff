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
        PictureDistance perceptual_in);

  const StageCapture& capture;
  StageSource source;
  BodyTrainSettings settings;
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

  std::optional<StageViews> views;  // decoded ahead
  double rate_factor() const;
  double normal_weight() const;
  double total(const BodyLossValues& values) const;
  // Views from this one of the present order on.
  void go_to(uint64_t number);
  void draw_view(BodyLossValues& mean);
  void update_networks();
  void update_maps();
  void update_colours();
  // What a new model needs to know before it is trained.
  void prepare_model();
  BodyLossValues step();
};

}  // namespace effigy
