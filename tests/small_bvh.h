// A small T-posed BVH file.
#pragma once

#include <unistd.h>

#include <filesystem>
#include <string>

#include "effigy/base/file.h"

namespace effigy::test {

inline const std::string kHierarchy = R"(HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
)";

inline std::string limb(const std::string& side, double s) {
  const auto joint = [&](const std::string& name, double x, double y, double z,
                         const std::string& inner) {
    return "JOINT " + side + name + "\n{\nOFFSET " + std::to_string(s * x) + " " +
           std::to_string(y) + " " + std::to_string(z) +
           "\nCHANNELS 3 Zrotation Yrotation Xrotation\n" + inner + "}\n";
  };
  const std::string end = "End Site\n{\nOFFSET 0 -5 0\n}\n";
  return joint(
             "UpLeg", 9, -4, 0,
             joint("Leg", 0, -40, 0, joint("Foot", 0, -40, 0, joint("ToeBase", 0, -4, 13, end)))) +
         joint("Arm", 18, 45, 0, joint("ForeArm", 28, 0, 0, joint("Hand", 25, 0, 0, end)));
}

// A T-posed skeleton in centimetres whose left forearm is turned by `angle` degrees about y.
inline std::string sound_file(double angle) {
  std::string text = kHierarchy + limb("Left", 1) + limb("Right", -1) +
                     "}\nMOTION\nFrames: 2\nFrame Time: 0.0333333\n";
  for (int frame = 0; frame < 2; ++frame) {
    text += "1 90 0 0 0 0";
    for (int joint = 0; joint < 14; ++joint)
      text += joint == 5 ? " 0 " + std::to_string(-angle) + " 0" : " 0 0 0";
    text += "\n";
  }
  return text;
}

class BvhFile {
 public:
  explicit BvhFile(const std::string& text)
      : path_(std::filesystem::temp_directory_path() /
              ("effigy_body_" + std::to_string(::getpid()) + ".bvh")) {
    write_text(path_, text);
  }
  ~BvhFile() { std::filesystem::remove(path_); }
  const Path& path() const { return path_; }

 private:
  Path path_;
};

}  // namespace effigy::test
