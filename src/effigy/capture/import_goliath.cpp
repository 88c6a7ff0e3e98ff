// The Goliath-4 layout: zip archives of AVIF pictures, calibration with transposed matrices in
// millimetres, light patterns by frame.

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <sstream>

#include "effigy/base/json.h"
#include "effigy/base/npy.h"
#include "effigy/base/zip_archive.h"
#include "effigy/capture/capture_parts.h"
#include "effigy/capture/import_source.h"
#include "effigy/geometry/ply.h"
#include "effigy/image/files.h"

namespace effigy {
namespace {

constexpr uint64_t kLargestEntry = uint64_t{256} << 20;
constexpr double kMetres = 1e-3;
// Pictures are 8-bit linear at half the calibration's resolution; black level, white balance, and
// the duration that counts as intensity 1 are those of the data set's own loader.
constexpr double kCalibrationScale = 0.5;
constexpr double kBlack[3] = {2, 1, 2}, kWhite[3] = {1.4, 1.1, 1.6}, kDuration = 5555;
// Tracking and segmentation that only fully lit frames have serve their neighbours too.
constexpr int64_t kReach = 3;

std::string number_name(int64_t frame) {
  std::string digits = std::to_string(frame);
  return std::string(6 - std::min<size_t>(6, digits.size()), '0') + digits;
}

std::shared_ptr<ZipArchive> zip_at(const Path& path) {
  if (!std::filesystem::exists(path)) return nullptr;
  return std::make_shared<ZipArchive>(path, "zip archive of the Goliath layout",
                                      "download it again");
}

std::string text_of(const std::vector<uint8_t>& bytes) {
  return {bytes.begin(), bytes.end()};
}

// The frame nearest to `frame` for which `has` is true, at most kReach away; throws Error.
template <typename Has>
int64_t nearest_frame(int64_t frame, const Has& has, const std::string& what) {
  for (int64_t step = 0; step <= kReach; ++step)
    for (const int64_t other : {frame - step, frame + step})
      if (has(other)) return other;
  throw Error("frame " + std::to_string(frame) + " has no " + what +
              ", and no frame beside it has; complete the source.");
}

// Numbers by name in the JSON of one frame's keypoints: an object or a list, of points that are
// lists of x, y, z or objects with such a list.
std::map<std::string, Vec3d> parse_keypoints(const std::string& text, const std::string& name) {
  const Json json = Json::parse(text, nullptr, false);
  std::map<std::string, Vec3d> points;
  const auto add = [&](const std::string& key, const Json& value) {
    const Json* list = &value;
    if (value.is_object())
      for (const Json& field : value)
        if (field.is_array()) list = &field;
    if (!list->is_array() || list->size() < 3) return;
    Vec3d point;
    for (size_t c = 0; c < 3; ++c) {
      if (!(*list)[c].is_number()) return;
      point[static_cast<int>(c)] = (*list)[c].get<double>() * kMetres;
    }
    points[key] = point;
  };
  if (json.is_object() && json.size() == 1 && json.begin()->is_structured() &&
      json.begin()->size() > 3)
    return parse_keypoints(json.begin()->dump(), name);
  if (json.is_object())
    for (const auto& [key, value] : json.items()) add(key, value);
  else if (json.is_array())
    for (size_t i = 0; i < json.size(); ++i) {
      std::string key = std::to_string(i);
      for (const char* field : {"name", "id"})
        if (json[i].is_object() && json[i].contains(field))
          key = json[i][field].is_string() ? json[i][field].get<std::string>()
                                           : json[i][field].dump();
      add(key, json[i]);
    }
  if (points.empty())
    throw Error(name +
                ": it holds no keypoints with three numbers each (NaN is no number in "
                "JSON); write it again.");
  return points;
}

class Goliath {
 public:
  Goliath(const Path& source, const StageImportOptions& options)
      : source_(source),
        registration_(zip_at(source / "kinematic_tracking" / "registration_vertices.zip")),
        keypoints_(zip_at(source / "keypoints_3d" / "keypoints_3d.zip")),
        head_pose_(zip_at(source / "head_pose" / "head_pose.zip")),
        backgrounds_(zip_at(source / "per_view_background" / "per_view_background.zip")) {
    if (registration_ == nullptr)
      throw Error(source.string() +
                  ": kinematic_tracking/registration_vertices.zip is missing, the tracked mesh of "
                  "every frame; complete the download.");
    read_cameras();
    read_lights();
    read_frames();
    read_mesh(options);
    if (keypoints_ != nullptr) read_keypoint_names();
  }

  ImportedStage stage(std::shared_ptr<Goliath> self) {
    ImportedStage stage;
    stage.capture = std::move(capture_);
    stage.keypoint_names = names_;
    stage.lights_at_center = true;
    stage.lit_evenly = lit_evenly_;
    stage.frames_left_out = left_out_;
    stage.first_problem = first_problem_;
    for (const StageFrame& frame : stage.capture.frames) {
      numbers_.push_back(frame.number);
      lit_.push_back(frame.fully_lit);
    }
    stage.background = [self](int camera) {
      return self->background(self->cameras_[static_cast<size_t>(camera)]);
    };
    for (const StageCamera& camera : stage.capture.cameras) cameras_.push_back(camera.name);
    stage.moment = [self](int frame) { return self->moment(self->numbers_[frame]); };
    stage.open = [self](int camera) { return self->open(self->cameras_[camera]); };
    return stage;
  }

 private:
  void leave_out(const std::string& sentence) {
    if (left_out_++ == 0) first_problem_ = sentence;
  }

  // Of `count` x `count` numbers, stored column by column.
  static Eigen::MatrixXd transposed(const Json& krt, const char* field, int count,
                                    const Path& file) {
    const auto rows = json_field<std::vector<std::vector<double>>>(krt, field, file);
    bool good = static_cast<int>(rows.size()) == count;
    for (const auto& row : rows) good = good && static_cast<int>(row.size()) >= 3;
    if (!good)
      throw Error(file.string() + ": field '" + field + "' must be " + std::to_string(count) +
                  " x " + std::to_string(count) + " numbers; download it again.");
    Eigen::MatrixXd m(3, count);
    for (int column = 0; column < count; ++column)
      for (int row = 0; row < 3; ++row)
        m(row, column) = rows[static_cast<size_t>(column)][static_cast<size_t>(row)];
    return m;
  }

  void read_cameras() {
    const Path file = source_ / "camera_calibration.json";
    for (const Json& krt : json_field<std::vector<Json>>(read_json(file), "KRT", file)) {
      const Json id = json_field<Json>(krt, "cameraId", file);
      StageCamera camera;
      camera.name = "cam" + (id.is_string() ? id.get<std::string>() : id.dump());
      if (!std::filesystem::exists(image_zip(camera.name))) continue;
      const Eigen::MatrixXd k = transposed(krt, "K", 3, file), t = transposed(krt, "T", 4, file);
      Camera& view = camera.camera;
      view.camera_from_world_rotation =
          checked_rotation(t.leftCols<3>(), file.string() + ": camera " + camera.name);
      view.camera_from_world_translation = kMetres * t.col(3);
      // Pixel centres are whole numbers there, halves here.
      view.fx = k(0, 0) * kCalibrationScale;
      view.fy = k(1, 1) * kCalibrationScale;
      view.cx = (k(0, 2) + 0.5) * kCalibrationScale;
      view.cy = (k(1, 2) + 0.5) * kCalibrationScale;
      capture_.cameras.push_back(camera);
    }
    if (capture_.cameras.empty())
      throw Error(source_.string() +
                  ": no camera of camera_calibration.json has pictures (image/cam….zip); complete "
                  "the download.");
    // All have one size; any picture tells it.
    for (StageCamera& camera : capture_.cameras) {
      const auto zip = zip_at(image_zip(camera.name));
      for (const std::string& name : zip->names()) {
        if (name.size() < 5 || name.substr(name.size() - 5) != ".avif") continue;
        try {
          const Image8 image = decode_image8(zip->read(name, kLargestEntry), name);
          for (StageCamera& other : capture_.cameras) {
            other.camera.width = image.width;
            other.camera.height = image.height;
          }
          return;
        } catch (const Error&) {
          continue;  // it will be counted when its turn comes
        }
      }
    }
    throw Error(source_.string() +
                ": no picture in image/cam….zip can be decoded (AVIF); download them again.");
  }

  Path image_zip(const std::string& camera) const { return source_ / "image" / (camera + ".zip"); }

  void read_lights() {
    const Path file = source_ / "lights" / "light_pattern_metadata.json";
    if (!std::filesystem::exists(file)) {
      lit_evenly_ = true;
      return;
    }
    const Json json = read_json(file);
    for (const auto& p :
         json_field<std::vector<std::vector<double>>>(json, "light_positions", file)) {
      if (p.size() != 3)
        throw Error(file.string() + ": a light position must be three numbers; download it again.");
      capture_.lights.push_back({(kMetres * Vec3d(p[0], p[1], p[2])).cast<float>(), Vec3f::Ones()});
    }
    for (const Json& pattern : json_field<std::vector<Json>>(json, "light_patterns", file)) {
      std::vector<std::pair<int, float>> lights;
      for (const auto& [light, duration] : json_field<std::vector<std::pair<int, double>>>(
               pattern, "light_index_durations", file)) {
        if (light < 0 || static_cast<size_t>(light) >= capture_.lights.size())
          throw Error(file.string() + ": pattern " + std::to_string(patterns_.size()) +
                      " names light " + std::to_string(light) + ", and only " +
                      std::to_string(capture_.lights.size()) +
                      " have a position; download it again.");
        if (!(duration >= 0) || !std::isfinite(duration))
          throw Error(file.string() + ": pattern " + std::to_string(patterns_.size()) +
                      " has a negative duration; download it again.");
        lights.emplace_back(light, static_cast<float>(duration / kDuration));
      }
      patterns_.push_back(std::move(lights));
    }
    const Path frames = source_ / "lights" / "light_pattern_per_frame.json";
    const Json list = read_json(frames);
    for (const Json& entry : list) {
      if (!entry.is_array() || entry.size() != 2 || !entry[0].is_number_integer() ||
          !entry[1].is_number_integer())
        throw Error(frames.string() +
                    ": it must list pairs of frame and pattern; download it "
                    "again.");
      pattern_of_[entry[0].get<int64_t>()] = entry[1].get<int64_t>();
    }
    make_full_light_one();
  }

  // Pattern 0 is "all lights": what they shine there becomes amount 1.
  void make_full_light_one() {
    if (patterns_.empty()) return;
    std::vector<float> full(capture_.lights.size(), 0.0f);
    for (const auto& [light, amount] : patterns_[0]) full[static_cast<size_t>(light)] += amount;
    for (size_t k = 0; k < full.size(); ++k)
      capture_.lights[k].intensity = Vec3f::Constant(full[k] > 0 ? full[k] : 0.0f);
    for (auto& pattern : patterns_)
      for (auto& [light, amount] : pattern) {
        float& one = full[static_cast<size_t>(light)];
        if (one > 0) {
          amount /= one;
          continue;
        }
        // Not among all lights, and yet shining: for its own sake only.
        one = 1.0f;
        capture_.lights[static_cast<size_t>(light)].intensity = Vec3f::Ones();
        all_are_full_ = false;
      }
  }

  void read_frames() {
    const Path file = source_ / "frame_splits_list.csv";
    std::istringstream text(read_text(file));
    std::string line;
    std::getline(text, line);
    size_t columns = 0, frame_column = 99, split_column = 99;
    const auto cells = [](const std::string& row) {
      std::vector<std::string> out;
      std::istringstream stream(row);
      for (std::string cell; std::getline(stream, cell, ',');) {
        cell.erase(0, cell.find_first_not_of(" \t\""));
        cell.erase(cell.find_last_not_of(" \t\r\"") + 1);
        out.push_back(cell);
      }
      return out;
    };
    for (const std::string& cell : cells(line)) {
      if (cell == "frame") frame_column = columns;
      if (cell == "split") split_column = columns;
      ++columns;
    }
    if (frame_column == 99 || split_column == 99)
      throw Error(file.string() +
                  ": its first line must name the columns 'frame' and 'split'; "
                  "download it again.");
    std::map<int64_t, bool> test;
    while (std::getline(text, line)) {
      const std::vector<std::string> row = cells(line);
      if (row.empty()) continue;
      const bool good = row.size() > std::max(frame_column, split_column) &&
                        !row[frame_column].empty() && row[frame_column].size() < 10 &&
                        row[frame_column].find_first_not_of("0123456789") == std::string::npos;
      if (!good)
        throw Error(file.string() + ": the line '" + line.substr(0, 40) +
                    "' names no frame; download it again.");
      test[std::stoll(row[frame_column])] = row[split_column] == "test";
    }
    for (const auto& [number, is_test] : test) add_frame(number, is_test);
    if (capture_.frames.empty())
      throw Error(file.string() +
                  ": none of its frames can be used, the first problem: " + first_problem_);
    hold_out(capture_);
  }

  void add_frame(int64_t number, bool is_test) {
    StageFrame frame;
    frame.number = number;
    frame.seconds = static_cast<double>(number) / capture_.frames_per_second;
    if (is_test) frame.split = StageSplit::kMotion;
    if (lit_evenly_) {
      frame.environment = kEvenLight;
      capture_.frames.push_back(frame);
      return;
    }
    const auto found = pattern_of_.find(number);
    if (found == pattern_of_.end() || found->second < 0 ||
        static_cast<size_t>(found->second) >= patterns_.size()) {
      leave_out("lights/light_pattern_per_frame.json: frame " + std::to_string(number) +
                " has no light pattern; complete it.");
      return;
    }
    if (found->second == 0 && all_are_full_) {
      frame.fully_lit = true;
    } else {
      frame.lights = patterns_[static_cast<size_t>(found->second)];
    }
    if (!frame.fully_lit && frame.lights.empty()) {
      leave_out("lights/light_pattern_per_frame.json: frame " + std::to_string(number) +
                " is lit by no light; complete it.");
      return;
    }
    capture_.frames.push_back(frame);
  }

  void read_mesh(const StageImportOptions& options) {
    Mesh mesh = imported_mesh(
        options, {},
        source_.string() +
            ": the Goliath layout keeps triangles and texture coordinates in its static assets "
            "(topology of static_assets_….pt); write them as an OBJ file and give it with --mesh "
            "FILE.obj.");
    std::vector<float> rest = template_vertices();
    if (rest.size() != mesh.vertices.size())
      throw Error(options.mesh.string() + ": it has " + std::to_string(mesh.vertex_count()) +
                  " vertices, the tracked meshes have " + std::to_string(rest.size() / 3) +
                  "; export the topology of the same subject and part.");
    mesh.vertices = std::move(rest);
    capture_.rig.mesh = std::move(mesh);
    capture_.rig.licence = "CC-BY-NC-4.0";
    capture_.licence = "CC-BY-NC-4.0 (Goliath-4)";
    capture_.source = source_.filename().string();
  }

  // Metres. The mean of all registrations, the template, or the first registration.
  std::vector<float> template_vertices() const {
    const Path tracking = source_ / "kinematic_tracking";
    std::vector<float> vertices;
    if (std::filesystem::exists(tracking / "registration_vertices_mean.npy")) {
      vertices = read_npy(tracking / "registration_vertices_mean.npy").floats();
      for (float& v : vertices) v *= static_cast<float>(kMetres);
    } else if (std::filesystem::exists(tracking / "template_mesh.ply")) {
      vertices = positions(read_ply_vertices(tracking / "template_mesh.ply"), "template_mesh.ply");
    } else {
      for (const StageFrame& frame : capture_.frames)
        if (registration_->has(registration_name(frame.number))) return registered(frame.number);
      throw Error(source_.string() +
                  ": no frame has a registration in kinematic_tracking/registration_vertices.zip; "
                  "complete the download.");
    }
    for (const float v : vertices)
      if (!std::isfinite(v))
        throw Error(tracking.string() +
                    ": the template has a vertex that is not finite; download it again.");
    return vertices;
  }

  static std::string registration_name(int64_t frame) {
    return "registration_vertices/" + number_name(frame) + ".ply";
  }

  static std::vector<float> positions(const PlyVertices& table, const std::string& name) {
    const int at[3] = {table.find("x"), table.find("y"), table.find("z")};
    if (std::min({at[0], at[1], at[2]}) < 0)
      throw Error(name + ": its vertices have no x, y, z; download it again.");
    std::vector<float> out;
    for (size_t v = 0; v < table.count(); ++v)
      for (const int column : at)
        out.push_back(static_cast<float>(kMetres) *
                      table.values[v * table.columns.size() + static_cast<size_t>(column)]);
    return out;
  }

  std::vector<float> registered(int64_t frame) const {
    const std::string name = registration_name(frame);
    return positions(parse_ply_vertices(registration_->read(name, kLargestEntry), name), name);
  }

  // From a table over frames that may have gaps: straight between the nearest on both sides, if
  // those are near.
  template <typename Has, typename Read>
  static std::vector<float> between(int64_t frame, const Has& has, const Read& read,
                                    const std::string& what) {
    if (has(frame)) return read(frame);
    int64_t before = frame, after = frame;
    while (!has(before) && before > frame - kReach) --before;
    while (!has(after) && after < frame + kReach) ++after;
    if (!has(before) || !has(after))
      throw Error("frame " + std::to_string(frame) + " has no " + what +
                  ", nor have frames close before and after it; complete the source.");
    std::vector<float> a = read(before);
    const std::vector<float> b = read(after);
    const float t = static_cast<float>(frame - before) / static_cast<float>(after - before);
    if (a.size() != b.size())
      throw Error("frames " + std::to_string(before) + " and " + std::to_string(after) + " have " +
                  what + " of different sizes; download them again.");
    for (size_t i = 0; i < a.size(); ++i) a[i] += t * (b[i] - a[i]);
    return a;
  }

  static std::string keypoint_name(int64_t frame) { return number_name(frame) + ".json"; }

  std::map<std::string, Vec3d> keypoints_of(int64_t frame) const {
    const std::string name = keypoint_name(frame);
    return parse_keypoints(text_of(keypoints_->read(name, kLargestEntry)), name);
  }

  // Those that the first frames have in common.
  void read_keypoint_names() {
    std::set<std::string> common;
    std::string problem = "it holds none of the frames";
    int looked_at = 0;
    for (const StageFrame& frame : capture_.frames) {
      if (!keypoints_->has(keypoint_name(frame.number))) continue;
      std::set<std::string> found;
      try {
        for (const auto& [name, point] : keypoints_of(frame.number)) found.insert(name);
      } catch (const Error& error) {
        problem = error.what();
        continue;  // it will be counted when its turn comes
      }
      if (looked_at == 0) common = found;
      std::set<std::string> both;
      std::set_intersection(common.begin(), common.end(), found.begin(), found.end(),
                            std::inserter(both, both.end()));
      common = both;
      if (++looked_at == 20) break;
    }
    if (looked_at > 0 && common.empty()) problem = "its frames have no keypoint in common";
    if (common.empty())
      throw Error(source_.string() + ": keypoints_3d/keypoints_3d.zip cannot be used: " + problem);
    names_.assign(common.begin(), common.end());
  }

  ImportedMoment moment(int64_t frame) const {
    ImportedMoment moment;
    moment.vertices = between(
        frame, [&](int64_t f) { return registration_->has(registration_name(f)); },
        [&](int64_t f) { return registered(f); }, "registration");
    if (!names_.empty())
      moment.keypoints = between(
          frame, [&](int64_t f) { return keypoints_->has(keypoint_name(f)); },
          [&](int64_t f) {
            const auto points = keypoints_of(f);
            std::vector<float> out;
            for (const std::string& name : names_) {
              const auto found = points.find(name);
              if (found == points.end())
                throw Error(keypoint_name(f) + ": the keypoint '" + name +
                            "', which other frames have, is missing; complete it.");
              for (int c = 0; c < 3; ++c) out.push_back(static_cast<float>(found->second[c]));
            }
            return out;
          },
          "keypoints");
    if (head_pose_ != nullptr) {
      const std::string name = number_name(frame) + ".txt";
      const std::vector<double> m =
          parse_table(text_of(head_pose_->read(name, kLargestEntry)), "head_pose.zip: " + name);
      if (m.size() != 12)
        throw Error("head_pose.zip: " + name + " must hold 3 x 4 numbers; download it again.");
      Mat3d rotation;
      rotation << m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10];
      rotation = checked_rotation(rotation, "head_pose.zip: " + name);
      moment.root.emplace();
      for (size_t i = 0; i < 12; ++i) {
        const int row = static_cast<int>(i / 4), column = static_cast<int>(i % 4);
        (*moment.root)[i] = static_cast<float>(column < 3 ? rotation(row, column) : kMetres * m[i]);
      }
    }
    return moment;
  }

  bool has_background(const std::string& camera) const {
    return backgrounds_ != nullptr && backgrounds_->has(camera + ".png");
  }
  Image8 background(const std::string& camera) const {
    if (!has_background(camera)) return {};
    const std::string name = camera + ".png";
    Image8 image = to_channels(
        decode_image8(backgrounds_->read(name, kLargestEntry), "per_view_background.zip: " + name),
        3);
    for (size_t i = 0; i < image.data.size(); ++i) image.data[i] = encoded_[i % 3][image.data[i]];
    return image;
  }

  std::function<ImportedView(int)> open(const std::string& camera) const {
    const auto images = zip_at(image_zip(camera));
    auto mattes = zip_at(source_ / "segmentation_fgbg" / (camera + ".zip"));
    if (mattes == nullptr) mattes = zip_at(source_ / "segmentation_parts" / (camera + ".zip"));
    if (mattes == nullptr)
      throw Error(source_.string() + ": segmentation_parts/" + camera +
                  ".zip is missing; complete the download.");
    return [this, images, mattes, camera](int frame) {
      const int64_t number = numbers_[static_cast<size_t>(frame)];
      const auto entry = [&](int64_t n, const char* extension) {
        return camera + "/" + number_name(n) + extension;
      };
      ImportedView view;
      const std::string name = entry(number, ".avif");
      view.image = to_channels(decode_image8(images->read(name, kLargestEntry),
                                             image_zip(camera).string() + ": " + name),
                               3);
      const int64_t matte = nearest_frame(
          number, [&](int64_t n) { return mattes->has(entry(n, ".png")); }, "segmentation");
      const std::string matte_name = entry(matte, ".png");
      const Image8 parts =
          to_channels(decode_image8(mattes->read(matte_name, kLargestEntry), matte_name), 1);
      view.mask = Image8(view.image.width, view.image.height, 1);
      // Some are of half the size.
      for (int y = 0; y < view.mask.height; ++y)
        for (int x = 0; x < view.mask.width; ++x)
          if (*parts.at(x * parts.width / view.mask.width, y * parts.height / view.mask.height))
            *view.mask.at(x, y) = 255;
      const bool whole = lit_[static_cast<size_t>(frame)] && has_background(camera);
      for (size_t i = 0; i < view.mask.data.size(); ++i)
        for (size_t c = 0; c < 3; ++c)
          view.image.data[3 * i + c] =
              whole || view.mask.data[i] ? encoded_[c][view.image.data[3 * i + c]] : uint8_t{0};
      return view;
    };
  }

  // sRGB of a picture's linear value.
  static std::array<std::array<uint8_t, 256>, 3> encoding() {
    std::array<std::array<uint8_t, 256>, 3> table;
    for (size_t c = 0; c < 3; ++c)
      for (size_t v = 0; v < 256; ++v) {
        const double linear =
            std::clamp((static_cast<double>(v) - kBlack[c]) * kWhite[c] / 255, 0.0, 1.0);
        table[c][v] =
            static_cast<uint8_t>(std::lround(255 * srgb_from_linear(static_cast<float>(linear))));
      }
    return table;
  }

  Path source_;
  std::shared_ptr<ZipArchive> registration_, keypoints_, head_pose_, backgrounds_;
  StageCapture capture_;
  std::vector<std::vector<std::pair<int, float>>> patterns_;
  std::map<int64_t, int64_t> pattern_of_;
  bool all_are_full_ = true, lit_evenly_ = false;
  std::vector<std::string> names_;  // of keypoints
  int left_out_ = 0;
  std::string first_problem_;
  std::vector<int64_t> numbers_;      // of frames
  std::vector<bool> lit_;             // fully, of frames
  std::vector<std::string> cameras_;  // names
  const std::array<std::array<uint8_t, 256>, 3> encoded_ = encoding();
};

}  // namespace

ImportedStage open_goliath(const Path& source, const StageImportOptions& options) {
  const auto goliath = std::make_shared<Goliath>(source, options);
  return goliath->stage(goliath);
}

}  // namespace effigy
