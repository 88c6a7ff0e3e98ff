// What the networks and the shading need of every frame of a stage capture.
#pragma once

#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "effigy/body/draw.h"
#include "effigy/body/irradiance.h"
#include "effigy/body/moment.h"
#include "effigy/body/stage_views.h"
#include "effigy/body/train_settings.h"

namespace effigy {

// Lamps as if far away: each in the texel of its direction from the stage's middle.
Cubemap stage_environment(const PointLights& lamps, int size);

class StageMoments {
 public:
  // shadow_texels: BodyModel::shadow_texels(). Keeps references to both.
  StageMoments(const StageSource& source, const UvTexels& shadow_texels,
               const BodyTrainSettings& settings);

  BodyMoment moment(const StageMoment& at) const;
  // Irradiance picture in the light of a frame (its own, or another's), found when it is first
  // asked for, one for each part of the light; empty without a shadow network.
  const std::vector<float>& irradiance(const StageMoment& at, const StageMoment& lit_as);
  // Shared by frames with the same environment.
  std::shared_ptr<const BodyLight> light(const StageMoment& at);
  // The mesh of a moment, for rays; valid until the next call.
  const RayScene& rays(const StageMoment& at);
  const StageSource& source() const { return source_; }

  // Mean irradiance picture over some of the frames: what the shadow network subtracts.
  std::vector<float> mean_irradiance(const std::vector<int>& frames);

 private:
  PointLights points(const StageMoment& at) const;
  // Lit by so many lamps that they count as an environment.
  bool many(const StageMoment& at) const;
  std::vector<float> irradiance_of(const TexelFrames& frames, const StageMoment& at,
                                   const StageMoment& lit_as);

  const StageSource& source_;
  const UvTexels& texels_;
  BodyTrainSettings settings_;
  TexelIrradiance irradiance_;
  std::unique_ptr<RayScene> rays_;
  std::map<std::pair<int, int>, std::vector<float>> found_;  // irradiance by frame and light
  std::map<std::string, std::shared_ptr<const BodyLight>> environments_;
  // One for each part of an environment.
  std::map<std::string, std::vector<EnvironmentSampler>> samplers_;
};

}  // namespace effigy
