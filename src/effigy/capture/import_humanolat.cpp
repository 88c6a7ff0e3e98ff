// HumanOLAT: static poses under one light at a time, AVIF pictures, a calibration in text blocks.

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <set>
#include <sstream>

#include "effigy/base/error.h"
#include "effigy/capture/capture_parts.h"
#include "effigy/capture/import_source.h"
#include "effigy/image/files.h"

namespace effigy {
namespace {

namespace fs = std::filesystem;

constexpr double kMetres = 1e-3;
// Pictures come in cycles of 21, of which the last shows all lights; the recording of single lights
// starts with such a one at number 14. Numbers as in the data set's own reader.
constexpr int kFirst = 14, kCycle = 21;
// Lights on the stage's door, whose places are not certain.
const std::set<int> kDoor = {178, 179, 208, 209, 210, 237, 238, 239, 240, 267, 268,
                             269, 270, 271, 295, 296, 297, 298, 319, 320, 321};

// "POSE_00" of "SUBJECT_x": the folder that holds images_processed.
Path pose_folder(const Path& source) {
  if (fs::is_directory(source / "images_processed")) return source;
  std::string poses;
  for (const auto& entry : fs::directory_iterator(source))
    if (fs::is_directory(entry.path() / "images_processed"))
      poses += (poses.empty() ? "" : ", ") + entry.path().filename().string();
  throw Error(source.string() + ": no folder images_processed in it; give the folder of one pose" +
              (poses.empty() ? "." : " (" + poses + ")."));
}

class HumanOlat {
 public:
  HumanOlat(const Path& source, const StageImportOptions& options)
      : pose_(pose_folder(source)), shared_(pose_.parent_path() / "shared") {
    find_pictures();
    read_cameras();
    read_lights();
    make_frames();
    const Path model = pose_ / "model" / "model.obj";
    capture_.rig.mesh = imported_mesh(
        options, fs::exists(model) ? model : Path(),
        model.string() +
            ": it is missing; give the mesh of this pose, in the same millimetres and "
            "with texture coordinates, with --mesh FILE.obj.");
    for (float& v : capture_.rig.mesh.vertices) v *= static_cast<float>(kMetres);
    capture_.rig.licence = capture_.licence = "HumanOLAT, non-commercial";
    capture_.source = fs::weakly_canonical(pose_).parent_path().filename().string() + "/" +
                      pose_.filename().string();
  }

  ImportedStage stage(std::shared_ptr<HumanOlat> self) {
    ImportedStage stage;
    stage.lights_at_center = true;
    stage.frames_left_out = left_out_;
    stage.first_problem = first_problem_;
    for (const StageFrame& frame : capture_.frames) numbers_.push_back(frame.number);
    stage.capture = capture_;
    stage.moment = [self](int) {  // nobody moves
      return ImportedMoment{self->capture_.rig.mesh.vertices, {}, {}};
    };
    stage.open = [self](int camera) { return self->open(camera); };
    return stage;
  }

 private:
  // "CAPTURE.000123.avif" of every camera, by number.
  void find_pictures() {
    for (const auto& folder : fs::directory_iterator(pose_ / "images_processed")) {
      const std::string name = folder.path().filename().string();
      if (!folder.is_directory() || name.rfind("Cam", 0) != 0) continue;
      for (const auto& file : fs::directory_iterator(folder.path())) {
        const std::string number = file.path().stem().extension().string();  // ".000123"
        if (file.path().extension() != ".avif" || number.size() < 2 || number.size() > 9 ||
            number.find_first_not_of("0123456789", 1) != std::string::npos)
          continue;
        pictures_[name][std::stoi(number.substr(1))] = file.path();
      }
    }
    if (pictures_.empty())
      throw Error((pose_ / "images_processed").string() +
                  ": it has no picture Cam…/….000000.avif; complete the download.");
  }

  // Blocks with a line "extrinsic" before 3 lines of 4 numbers (world from camera, millimetres) and
  // a line "intrinsic" before 3 of 3 (in units of the picture's width), camera after camera.
  void read_cameras() {
    Path file = shared_ / "cameras.calib";
    if (!fs::exists(file)) file = shared_ / "camera.calib";
    std::istringstream text(read_text(file));
    const int width = picture_size().first, height = picture_size().second;
    const auto rows = [&](int count) {
      std::string all, line;
      for (int row = 0; row < 3 && std::getline(text, line); ++row) {
        line.erase(std::remove(line.begin(), line.end(), '#'), line.end());
        all += line + "\n";
      }
      std::vector<double> numbers = parse_table(all, file.string());
      if (static_cast<int>(numbers.size()) != 3 * count)
        throw Error(file.string() + ": a matrix in it is not 3 x " + std::to_string(count) +
                    " numbers; download it again.");
      return numbers;
    };
    std::vector<Camera> cameras;
    bool placed = false;
    Camera camera;
    for (std::string line; std::getline(text, line);) {
      if (line.find("extrinsic") != std::string::npos) {
        const std::vector<double> m = rows(4);
        Mat3d turn;
        turn << m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10];
        const Mat3d inverse =
            checked_rotation(turn, file.string() + ": camera " + std::to_string(cameras.size() + 1))
                .transpose();
        camera.camera_from_world_rotation = inverse;
        camera.camera_from_world_translation = -kMetres * (inverse * Vec3d(m[3], m[7], m[11]));
        placed = true;
      } else if (line.find("intrinsic") != std::string::npos) {
        const std::streampos here = text.tellg();
        std::string next;
        if (std::getline(text, next) && next.find("time") != std::string::npos) continue;
        text.seekg(here);
        const std::vector<double> k = rows(3);
        if (!placed || !(k[0] > 0) || !(k[4] > 0))
          throw Error(file.string() + ": camera " + std::to_string(cameras.size() + 1) +
                      " has no place or no positive focal length; download it again.");
        camera.width = width;
        camera.height = height;
        camera.fx = k[0] * width;
        camera.fy = k[4] * width;
        camera.cx = k[2] * width;
        camera.cy = k[5] * width;
        cameras.push_back(camera);
      }
    }
    // The calibration's n-th camera is "Cam" and n in two digits.
    for (size_t c = 0; c < cameras.size(); ++c) {
      const std::string name = (c < 9 ? "Cam0" : "Cam") + std::to_string(c + 1);
      if (pictures_.count(name)) capture_.cameras.push_back({name, cameras[c], false});
    }
    if (capture_.cameras.empty())
      throw Error(file.string() + ": none of its " + std::to_string(cameras.size()) +
                  " cameras has pictures in images_processed; complete the download.");
  }

  // Width and height of the first picture that can be decoded.
  std::pair<int, int> picture_size() {
    if (size_.first > 0) return size_;
    std::string problem;
    for (const auto& [camera, files] : pictures_)
      for (const auto& [number, file] : files) {
        try {
          const Image8 image = read_image8(file);
          return size_ = {image.width, image.height};
        } catch (const Error& error) {
          problem = error.what();
        }
      }
    throw Error(problem);
  }

  void read_lights() {
    const Path places = shared_ / "LSX_light_positions_aligned.pc",
               order = shared_ / "LSX3_light_z_spiral.txt";
    std::istringstream text(read_text(places));
    for (std::string line; std::getline(text, line);) {
      if (line.rfind("v ", 0) != 0) continue;
      const std::vector<double> p = parse_table(line.substr(2), places.string());
      if (p.size() < 3)
        throw Error(places.string() + ": a line 'v' has no three numbers; download it again.");
      capture_.lights.push_back({Vec3d(p[0], p[1], p[2]).cast<float>(), Vec3f::Ones()});
    }
    const std::vector<double> sequence = parse_table(read_text(order), order.string());
    if (sequence.size() != capture_.lights.size())
      throw Error(order.string() + ": it orders " + std::to_string(sequence.size()) +
                  " lights, and " + places.filename().string() + " places " +
                  std::to_string(capture_.lights.size()) + "; download both again.");
    for (const double number : sequence) {
      if (number != std::floor(number) || number < 1 ||
          number > static_cast<double>(capture_.lights.size()))
        throw Error(order.string() + ": light " + std::to_string(number) +
                    " does not exist; download it again.");
      sequence_.push_back(static_cast<int>(number) - 1);
    }
  }

  void make_frames() {
    size_t next = 0;
    for (int step = 1; next < sequence_.size(); ++step) {
      if (step % kCycle == kCycle - 1) continue;  // all lights, of a strength nobody tells
      const int light = sequence_[next++], number = kFirst + step;
      if (kDoor.count(light)) continue;
      const bool seen = std::any_of(pictures_.begin(), pictures_.end(),
                                    [&](const auto& of) { return of.second.count(number) > 0; });
      if (!seen) {
        if (left_out_++ == 0)
          first_problem_ = (pose_ / "images_processed").string() + ": picture " +
                           std::to_string(number) + " is missing; complete the download.";
        continue;
      }
      StageFrame frame;
      frame.number = number;
      frame.seconds = static_cast<double>(number) / capture_.frames_per_second;
      frame.lights = {{light, 1.0f}};
      capture_.frames.push_back(frame);
    }
    if (capture_.frames.empty())
      throw Error(pose_.string() + ": it has no picture of a single light (numbers from " +
                  std::to_string(kFirst + 1) + "); complete the download.");
    hold_out(capture_);
  }

  std::function<ImportedView(int)> open(int camera) const {
    const std::string name = capture_.cameras[static_cast<size_t>(camera)].name;
    const Image8 mask =
        to_channels(read_image8(pose_ / "segmentations" / "masks" / "000" / (name + ".png")), 1);
    const std::map<int, Path>& files = pictures_.at(name);
    return [this, mask, &files, name](int frame) {
      const auto number = static_cast<int>(numbers_[static_cast<size_t>(frame)]);
      const auto found = files.find(number);
      if (found == files.end())
        throw Error((pose_ / "images_processed" / name).string() + ": picture " +
                    std::to_string(number) + " is missing; complete the download.");
      ImportedView view{to_channels(read_image8(found->second), 3), mask};
      // The matte of the first picture, 0 or not, maybe of another size.
      view.mask = Image8(view.image.width, view.image.height, 1);
      for (int y = 0; y < view.mask.height; ++y)
        for (int x = 0; x < view.mask.width; ++x)
          if (*mask.at(x * mask.width / view.mask.width, y * mask.height / view.mask.height))
            *view.mask.at(x, y) = 255;
      put_on_black(view.mask, view.image);
      return view;
    };
  }

  Path pose_, shared_;
  std::map<std::string, std::map<int, Path>> pictures_;  // by camera and number
  std::pair<int, int> size_{0, 0};
  StageCapture capture_;
  std::vector<int> sequence_;  // lights in the order of the recording
  int left_out_ = 0;
  std::string first_problem_;
  std::vector<int64_t> numbers_;
};

}  // namespace

ImportedStage open_humanolat(const Path& source, const StageImportOptions& options) {
  const auto olat = std::make_shared<HumanOlat>(source, options);
  return olat->stage(olat);
}

}  // namespace effigy
