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
#include "effigy/body/train_settings.h"
#include "effigy/capture/stage_capture.h"

namespace effigy {

// The light of a group of lamps, as strengths at the stage's middle: Irradiance there of each is
// intensity / distance^2.
PointLights stage_points(const std::vector<StageLight>& lights, bool falloff);
// The same lamps as if far away: each in the texel of its direction from the stage's middle.
Cubemap stage_environment(const std::vector<StageLight>& lights, int size);

class StageMoments {
 public:
  // shadow_texels: BodyModel::shadow_texels(). Keeps references to both.
  StageMoments(const StageCapture& capture, const UvTexels& shadow_texels,
               const BodyTrainSettings& settings);

  // In root frames.
  struct Keypoints {
    std::vector<float> body, face;
  };
  Keypoints keypoints(int frame) const;
  // Loads the frame's mesh; finds its irradiance when it is first asked for. Throws Error naming
  // the file.
  BodyMoment moment(int frame) { return moment(frame, frame); }
  // As lit by the light of another frame.
  BodyMoment moment(int frame, int frame_of_light);
  // Shared by frames with the same light where that pays (environments).
  std::shared_ptr<const BodyLight> light(int frame);
  // The mesh of the last moment(), for rays.
  const RayScene& rays() const { return *rays_; }

  // Mean irradiance picture over some of the frames: what the shadow network subtracts.
  std::vector<float> mean_irradiance(const std::vector<int>& frames);

 private:
  const std::vector<float>& irradiance(int frame, int frame_of_light,
                                       const std::vector<float>& vertices);

  const StageCapture& capture_;
  const UvTexels& texels_;
  BodyTrainSettings settings_;
  TexelIrradiance irradiance_;
  std::unique_ptr<RayScene> rays_;
  std::map<std::pair<int, int>, std::vector<float>> found_;  // irradiance by frame and light
  std::map<std::string, std::shared_ptr<const BodyLight>> environments_;
  std::map<std::string, std::shared_ptr<const EnvironmentSampler>> samplers_;
};

}  // namespace effigy
