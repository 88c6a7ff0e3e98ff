// Finding the published networks: MediaPipe's face_landmarker.task (detector, 478 landmarks, 52
// blendshape scores) when the user has it, else the npm packages' detector and 468 landmarks; and
// the selfie segmentation network.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "effigy/base/file.h"

namespace effigy {

struct ModelSet {
  std::vector<uint8_t> detector;     // TFLite, 128x128, [-1, 1]
  std::vector<uint8_t> landmarks;    // TFLite, 256x256 (478 points) or 192x192 (468), [0, 1]
  std::vector<uint8_t> blendshapes;  // TFLite, 146 points; empty when only the npm models exist
  std::vector<uint8_t> matte;        // TFLite, 256x256 selfie segmentation; may be empty
  int landmark_count = 0;            // 478 or 468
  Path landmarks_path, matte_path;   // the files they came from
  // One line for people and track.json, e.g. "face_landmarker.task (478 landmarks, blendshapes),
  // selfie_segmentation.tflite".
  std::string description() const;
};

// Looks in `folder` when given (only there), else in $EFFIGY_DATA/models, then in the node_modules
// folder $EFFIGY_NPM. A folder may hold face_landmarker.task, face_mesh_solution_packed_assets.data
// and selfie_segmentation.tflite directly, or be a node_modules folder. `need_matte`: a missing
// matte network is an error. Throws Error saying where it looked and what to do.
ModelSet find_models(const std::optional<Path>& folder, bool need_matte = true);

}  // namespace effigy
