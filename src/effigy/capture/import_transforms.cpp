// transforms_*.json with a point light for every picture: NRHints, GS3 and what follows them.
// Blender's cameras (x right, y up, z back) and, usually, its world (z up).

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>

#include "effigy/base/json.h"
#include "effigy/capture/capture_parts.h"
#include "effigy/capture/import_source.h"
#include "effigy/image/files.h"

namespace effigy {
namespace {

namespace fs = std::filesystem;

constexpr const char* kTrain[] = {"transforms_train.json", "transforms.json"};
constexpr const char* kTest = "transforms_test.json";
constexpr double kSame = 1e-9;  // cameras and lights that differ less are one

class Transforms {
 public:
  Transforms(const Path& source, const StageImportOptions& options) : source_(source) {
    bool found = false;
    for (const char* name : kTrain)
      if (!found && fs::exists(source / name)) {
        read(source / name, false);
        found = true;
      }
    if (!found)
      throw Error(source.string() +
                  ": neither transforms_train.json nor transforms.json is in it; check the path.");
    if (fs::exists(source / kTest)) read(source / kTest, true);
    if (capture_.frames.empty())
      throw Error(source.string() + ": its transforms list no pictures that can be used" +
                  (first_problem_.empty() ? "; check the files." : ", the first problem: ") +
                  first_problem_);
    for (StageFrame& frame : capture_.frames) std::sort(frame.cameras.begin(), frame.cameras.end());
    if (!has_test_) hold_out(capture_);
    capture_.rig.mesh =
        imported_mesh(options, {},
                      source.string() +
                          ": a transforms.json has no mesh; give that of the scene, in the same "
                          "world and with texture coordinates, with --mesh FILE.obj.");
    capture_.source = fs::weakly_canonical(source).filename().string();
    capture_.rig.licence = "not stated";
  }

  ImportedStage stage(std::shared_ptr<Transforms> self) {
    ImportedStage stage;
    stage.capture = capture_;
    stage.up = "z";
    stage.frames_left_out = left_out_;
    stage.first_problem = first_problem_;
    stage.moment = [self](int) { return ImportedMoment{self->capture_.rig.mesh.vertices, {}, {}}; };
    stage.open = [self](int camera) -> std::function<ImportedView(int)> {
      return [self, camera](int frame) { return self->view(camera, frame); };
    };
    return stage;
  }

 private:
  void read(const Path& file, bool test) {
    const Json json = read_json(file);
    for (const Json& frame : json_field<std::vector<Json>>(json, "frames", file)) {
      try {
        add(json, frame, file, test);
      } catch (const Error& error) {
        if (left_out_++ == 0) first_problem_ = error.what();
      }
    }
  }

  void add(const Json& json, const Json& entry, const Path& file, bool test) {
    const auto name = json_field<std::string>(entry, "file_path", file);
    Path path = name;
    if (path.is_relative()) path = file.parent_path() / path;
    const auto extension = json_field_or<std::string>(entry, "file_ext", file, ".png");
    if (path.extension() != extension) path += extension;
    if (!entry.contains("pl_pos"))
      throw Error(file.string() + ": picture '" + name +
                  "' has no light (field 'pl_pos'); add its position.");
    const int camera = camera_number(camera_of(json, entry, file, path));
    const int frame = frame_number(light_of(entry, file, name));
    if (!pictures_.emplace(std::pair(camera, frame), path).second)
      throw Error(file.string() + ": picture '" + name +
                  "' has the camera and the light of another one; remove one of them.");
    capture_.frames[static_cast<size_t>(frame)].cameras.push_back(camera);
    // What only the test file shows is held out.
    if (test) has_test_ = true;
    if (test && camera_is_new_) capture_.cameras.back().test = true;
    if (test && frame_is_new_) capture_.frames.back().split = StageSplit::kLights;
  }

  static std::vector<double> numbers(const Json& json, const char* field, size_t count,
                                     const Path& file) {
    const auto values = json_field<std::vector<double>>(json, field, file);
    bool good = values.size() == count;
    for (const double v : values) good = good && std::isfinite(v);
    if (!good)
      throw Error(file.string() + ": field '" + field + "' must be " + std::to_string(count) +
                  " finite numbers; correct it.");
    return values;
  }

  Camera camera_of(const Json& json, const Json& entry, const Path& file, const Path& picture) {
    if (size_.first == 0) {
      const Image image = read_image(picture);
      size_ = {image.width, image.height};
    }
    Camera camera;
    camera.width = size_.first;
    camera.height = size_.second;
    const Json& holder = entry.contains("camera_intrinsics") ? entry : json;
    if (holder.contains("camera_intrinsics")) {
      const std::vector<double> k = numbers(holder, "camera_intrinsics", 4, file);
      camera.cx = k[0];
      camera.cy = k[1];
      camera.fx = k[2];
      camera.fy = k[3];
    } else {
      const auto angle = json_field<double>(json, "camera_angle_x", file);
      camera.fx = camera.fy = 0.5 * camera.width / std::tan(0.5 * angle);
      camera.cx = 0.5 * camera.width;
      camera.cy = 0.5 * camera.height;
    }
    const auto rows = json_field<std::vector<std::vector<double>>>(entry, "transform_matrix", file);
    bool good = rows.size() >= 3 && camera.fx > 0 && camera.fy > 0 &&
                std::isfinite(camera.fx + camera.fy + camera.cx + camera.cy);
    for (size_t row = 0; good && row < 3; ++row) good = rows[row].size() == 4;
    if (!good)
      throw Error(file.string() + ": the camera of picture '" + picture.filename().string() +
                  "' needs a transform_matrix of 4 x 4 numbers and a positive focal length; "
                  "correct it.");
    Mat3d world_from_camera;
    Vec3d at;
    for (int row = 0; row < 3; ++row) {
      const auto& values = rows[static_cast<size_t>(row)];
      world_from_camera.row(row) = Vec3d(values[0], -values[1], -values[2]);
      at[row] = values[3];
    }
    const Mat3d inverse = checked_rotation(world_from_camera, file.string() + ": picture '" +
                                                                  picture.filename().string() + "'")
                              .transpose();
    camera.camera_from_world_rotation = inverse;
    camera.camera_from_world_translation = -inverse * at;
    if (!at.allFinite())
      throw Error(file.string() + ": field 'transform_matrix' is not finite; correct it.");
    return camera;
  }

  StageLight light_of(const Json& entry, const Path& file, const std::string& name) const {
    const std::vector<double> p = numbers(entry, "pl_pos", 3, file);
    StageLight light{Vec3d(p[0], p[1], p[2]).cast<float>(), Vec3f::Ones()};
    if (!entry.contains("pl_intensity")) return light;
    if (entry["pl_intensity"].is_number()) {
      light.intensity *= entry["pl_intensity"].get<float>();
    } else {
      const std::vector<double> i = numbers(entry, "pl_intensity", 3, file);
      light.intensity = Vec3d(i[0], i[1], i[2]).cast<float>();
    }
    if (!light.intensity.allFinite() || light.intensity.minCoeff() < 0 ||
        !(light.intensity.maxCoeff() > 0))
      throw Error(file.string() + ": field 'pl_intensity' of picture '" + name +
                  "' must be positive; correct it.");
    return light;
  }

  int camera_number(const Camera& camera) {
    camera_is_new_ = false;
    for (size_t c = 0; c < capture_.cameras.size(); ++c) {
      const Camera& other = capture_.cameras[c].camera;
      const double difference =
          (other.camera_from_world_rotation - camera.camera_from_world_rotation).norm() +
          (other.camera_from_world_translation - camera.camera_from_world_translation).norm() +
          std::abs(other.fx - camera.fx) + std::abs(other.fy - camera.fy) +
          std::abs(other.cx - camera.cx) + std::abs(other.cy - camera.cy);
      if (difference < kSame) return static_cast<int>(c);
    }
    camera_is_new_ = true;
    const std::string number = std::to_string(capture_.cameras.size());
    capture_.cameras.push_back(
        {"camera" + std::string(4 - std::min<size_t>(4, number.size()), '0') + number, camera,
         false});
    return static_cast<int>(capture_.cameras.size()) - 1;
  }

  int frame_number(const StageLight& light) {
    frame_is_new_ = false;
    for (size_t k = 0; k < capture_.lights.size(); ++k) {
      const StageLight& other = capture_.lights[k];
      if (static_cast<double>((other.position - light.position).norm() +
                              (other.intensity - light.intensity).norm()) < kSame)
        return static_cast<int>(k);
    }
    frame_is_new_ = true;
    StageFrame frame;
    frame.number = static_cast<int64_t>(capture_.frames.size());
    frame.lights = {{static_cast<int>(capture_.lights.size()), 1.0f}};
    capture_.lights.push_back(light);
    capture_.frames.push_back(frame);
    return static_cast<int>(capture_.frames.size()) - 1;
  }

  ImportedView view(int camera, int frame) const {
    const Path& path = pictures_.at({camera, frame});
    Image image = read_image(path);
    if (image.channels != 4)
      throw Error(path.string() + ": it has no alpha channel, which is the matte; add one (RGBA).");
    const std::string extension = path.extension().string();
    const bool linear = extension == ".exr" || extension == ".hdr";
    for (const float value : image.data)
      if (!std::isfinite(value))
        throw Error(path.string() + ": it holds a value that is not finite; write it again.");
    ImportedView view{Image8(image.width, image.height, 3), Image8(image.width, image.height, 1)};
    for (size_t i = 0; i < view.mask.data.size(); ++i) {
      const float* p = &image.data[4 * i];
      const float alpha = std::clamp(p[3], 0.0f, 1.0f);
      view.mask.data[i] = static_cast<uint8_t>(std::lround(255 * alpha));
      for (size_t c = 0; c < 3; ++c) {
        // Straight alpha in integers; floats are premultiplied.
        const float value = linear ? srgb_from_linear(std::clamp(p[c], 0.0f, 1.0f)) : p[c] * alpha;
        view.image.data[3 * i + c] =
            static_cast<uint8_t>(std::lround(255 * std::clamp(value, 0.0f, 1.0f)));
      }
    }
    return view;
  }

  Path source_;
  StageCapture capture_;
  std::pair<int, int> size_{0, 0};
  std::map<std::pair<int, int>, Path> pictures_;  // by camera and frame
  bool has_test_ = false, camera_is_new_ = false, frame_is_new_ = false;
  int left_out_ = 0;
  std::string first_problem_;
};

}  // namespace

ImportedStage open_transforms(const Path& source, const StageImportOptions& options) {
  const auto transforms = std::make_shared<Transforms>(source, options);
  return transforms->stage(transforms);
}

}  // namespace effigy
