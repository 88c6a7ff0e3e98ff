#include "effigy/infer/models.h"

#include <cstdlib>

#include "effigy/base/error.h"
#include "effigy/base/zip_archive.h"

namespace effigy {
namespace {

constexpr uint64_t kMostBytes = uint64_t{64} << 20;

void read_task(const Path& path, ModelSet& models) {
  const ZipArchive archive(path, "face_landmarker.task bundle", "download it again");
  models.detector = archive.read("face_detector.tflite", kMostBytes);
  models.landmarks = archive.read("face_landmarks_detector.tflite", kMostBytes);
  const std::string blendshapes = "face_blendshapes.tflite";
  if (archive.has(blendshapes)) models.blendshapes = archive.read(blendshapes, kMostBytes);
  models.landmark_count = 478;
  models.landmarks_path = path;
}

// npm's @mediapipe/face_mesh 0.4.1657299874 concatenates its files; the ranges stand in its loader.
void read_packed(const Path& path, ModelSet& models) {
  constexpr size_t kLandmarksBegin = 2495952, kLandmarksEnd = 3737848;
  constexpr size_t kDetectorBegin = 3757224, kDetectorEnd = 3986256;
  const std::vector<uint8_t> bytes = read_file(path, kMostBytes);
  if (bytes.size() != kDetectorEnd)
    throw Error(path.string() +
                ": not the packed assets of @mediapipe/face_mesh 0.4.1657299874 (it has " +
                std::to_string(bytes.size()) + " bytes instead of " + std::to_string(kDetectorEnd) +
                "); install that version.");
  models.landmarks.assign(bytes.begin() + kLandmarksBegin, bytes.begin() + kLandmarksEnd);
  models.detector.assign(bytes.begin() + kDetectorBegin, bytes.end());
  models.landmark_count = 468;
  models.landmarks_path = path;
}

bool is_there(const Path& path) {
  std::error_code problem;
  return std::filesystem::exists(path, problem);
}

void look_in(const Path& folder, ModelSet& models) {
  if (models.landmarks.empty()) {
    const Path packed = "face_mesh_solution_packed_assets.data";
    if (is_there(folder / "face_landmarker.task")) {
      read_task(folder / "face_landmarker.task", models);
    } else {
      for (const Path& path : {folder / packed, folder / "@mediapipe/face_mesh" / packed,
                               folder / "node_modules/@mediapipe/face_mesh" / packed})
        if (models.landmarks.empty() && is_there(path)) read_packed(path, models);
    }
  }
  const Path selfie = "selfie_segmentation.tflite";
  for (const Path& path : {folder / selfie, folder / "@mediapipe/selfie_segmentation" / selfie,
                           folder / "node_modules/@mediapipe/selfie_segmentation" / selfie})
    if (models.matte.empty() && is_there(path)) {
      models.matte = read_file(path, kMostBytes);
      models.matte_path = path;
    }
}

}  // namespace

std::string ModelSet::description() const {
  std::string text = landmarks_path.filename().string() + " (" + std::to_string(landmark_count) +
                     " landmarks" + (blendshapes.empty() ? ")" : ", blendshapes)");
  if (!matte.empty()) text += ", " + matte_path.filename().string();
  return text;
}

ModelSet find_models(const std::optional<Path>& folder, bool need_matte) {
  std::vector<Path> places;
  if (folder) {
    places.push_back(*folder);
    if (!std::filesystem::is_directory(*folder))
      throw Error("--models " + folder->string() +
                  ": there is no such folder; name one that holds face_landmarker.task or the npm "
                  "packages @mediapipe/face_mesh and @mediapipe/selfie_segmentation.");
  } else {
    if (const char* data = std::getenv("EFFIGY_DATA"); data != nullptr && *data != '\0')
      places.push_back(Path(data) / "models");
    if (const char* npm = std::getenv("EFFIGY_NPM"); npm != nullptr && *npm != '\0')
      places.emplace_back(npm);
  }
  ModelSet models;
  std::string looked;
  for (const Path& place : places) {
    look_in(place, models);
    looked += (looked.empty() ? "" : ", ") + place.string();
  }
  const std::string where =
      looked.empty() ? "neither $EFFIGY_DATA nor $EFFIGY_NPM is set" : "looked in " + looked;
  if (models.landmarks.empty())
    throw Error("The face networks are missing (" + where +
                "): run through the launcher './effigy', which fetches them from npm, or put "
                "MediaPipe's face_landmarker.task into a folder and name it with --models.");
  if (need_matte && models.matte.empty())
    throw Error("The network selfie_segmentation.tflite is missing (" + where +
                "): run through the launcher './effigy', which fetches it from npm, put it into "
                "the --models folder, or give your own mattes with --matte.");
  return models;
}

}  // namespace effigy
