#include "effigy/rig/bvh.h"

#include <array>
#include <charconv>
#include <cmath>
#include <numbers>
#include <string_view>

#include "effigy/base/error.h"

namespace effigy {
namespace {

constexpr size_t kMostJoints = 1024;
constexpr int kMostFrames = 1'000'000;
constexpr double kMostSize = 1e6;

class Reader {
 public:
  Reader(std::string text, std::string name) : text_(std::move(text)), name_(std::move(name)) {}

  Bvh read() {
    expect("HIERARCHY");
    expect("ROOT");
    joint(-1, 0);
    if (peek() == "ROOT") fail("has a second ROOT; keep one skeleton in the file");
    motion();
    return std::move(bvh_);
  }

 private:
  [[noreturn]] void fail(const std::string& what) const {
    throw Error(name_ + ", line " + std::to_string(line_) + ": the BVH file " + what + ".");
  }

  static bool space(char c) { return c == ' ' || c == '\t' || c == '\n' || c == '\r'; }
  std::string_view next() {
    while (at_ < text_.size() && space(text_[at_])) line_ += text_[at_++] == '\n';
    const size_t from = at_;
    while (at_ < text_.size() && !space(text_[at_])) ++at_;
    return std::string_view(text_).substr(from, at_ - from);
  }
  std::string_view peek() {
    const size_t at = at_;
    const int line = line_;
    const std::string_view word = next();
    at_ = at;
    line_ = line;
    return word;
  }
  void expect(std::string_view word) {
    const std::string_view found = next();
    if (found != word)
      fail("has '" + std::string(found.substr(0, 40)) + "' where '" + std::string(word) +
           "' is expected; export it again");
  }
  double number() {
    const std::string_view word = next();
    double value = 0;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
    if (word.empty() || error != std::errc() || end != word.data() + word.size() ||
        !std::isfinite(value) || std::abs(value) > kMostSize)
      fail("has '" + std::string(word.substr(0, 40)) +
           "' where a finite number is expected; export it again");
    return value;
  }
  int count(int most, const char* what) {
    const double value = number();
    if (value < 0 || value > most || value != std::floor(value))
      fail(std::string("has an impossible number of ") + what + "; export it again");
    return static_cast<int>(value);
  }

  void offset(BvhJoint& j) {
    expect("OFFSET");
    for (int c = 0; c < 3; ++c) j.offset[c] = number();
  }

  void joint(int parent, int depth) {
    if (depth > 200) fail("nests joints more than 200 deep; simplify the skeleton");
    if (bvh_.joints.size() >= kMostJoints) fail("has more than 1024 joints; simplify the skeleton");
    BvhJoint j;
    j.name = std::string(next());
    j.parent = parent;
    if (j.name.empty() || j.name == "{") fail("has a joint without a name");
    expect("{");
    offset(j);
    expect("CHANNELS");
    const int channels = count(6, "channels");
    static constexpr std::array<std::string_view, 6> kNames = {
        "Xposition", "Yposition", "Zposition", "Xrotation", "Yrotation", "Zrotation"};
    for (int c = 0; c < channels; ++c) {
      const std::string_view word = next();
      int kind = -1;
      for (int k = 0; k < 6; ++k)
        if (word == kNames[static_cast<size_t>(k)]) kind = k;
      if (kind < 0) fail("has the unknown channel '" + std::string(word.substr(0, 40)) + "'");
      j.channels.push_back(kind);
    }
    j.first_channel = bvh_.channel_count;
    bvh_.channel_count += channels;
    const int number_of_joint = static_cast<int>(bvh_.joints.size());
    const std::string name = j.name;
    bvh_.joints.push_back(std::move(j));
    for (;;) {
      const std::string_view word = next();
      if (word == "}") return;
      if (word == "JOINT") {
        joint(number_of_joint, depth + 1);
      } else if (word == "End") {
        expect("Site");
        expect("{");
        BvhJoint end;
        end.name = name + "_end";
        end.parent = number_of_joint;
        end.end = true;
        end.first_channel = bvh_.channel_count;
        offset(end);
        expect("}");
        if (bvh_.joints.size() >= kMostJoints)
          fail("has more than 1024 joints; simplify the skeleton");
        bvh_.joints.push_back(std::move(end));
      } else {
        fail("has '" + std::string(word.substr(0, 40)) + "' inside a joint; export it again");
      }
    }
  }

  void motion() {
    expect("MOTION");
    expect("Frames:");
    const int frames = count(kMostFrames, "frames");
    expect("Frame");
    expect("Time:");
    bvh_.frame_seconds = number();
    if (frames == 0 || bvh_.channel_count == 0) fail("has no motion; export it with frames");
    if (!(bvh_.frame_seconds > 1e-5 && bvh_.frame_seconds < 100))
      fail("has an impossible frame time; it is in seconds");
    const size_t wanted = static_cast<size_t>(frames) * static_cast<size_t>(bvh_.channel_count);
    // A number and a space each at least: a header cannot ask for more than the file holds.
    if (wanted > (text_.size() - at_) / 2 + 1)
      fail("ends before its " + std::to_string(frames) + " frames; export it again");
    bvh_.values.reserve(wanted);
    for (size_t i = 0; i < wanted; ++i) bvh_.values.push_back(number());
    if (!next().empty()) fail("goes on after its last frame; export it again");
  }

  std::string text_, name_;
  size_t at_ = 0;
  int line_ = 1;
  Bvh bvh_;
};

}  // namespace

int Bvh::joint(const std::string& name) const {
  for (size_t j = 0; j < joints.size(); ++j)
    if (joints[j].name == name) return static_cast<int>(j);
  return -1;
}

void Bvh::pose(int frame, std::vector<Mat3d>& rotations, std::vector<Vec3d>& positions) const {
  EFFIGY_CHECK(frame >= -1 && frame < frames());
  rotations.assign(joints.size(), Mat3d::Identity());
  positions.assign(joints.size(), Vec3d::Zero());
  for (size_t j = 0; j < joints.size(); ++j) {
    const BvhJoint& joint = joints[j];
    Mat3d local = Mat3d::Identity();
    Vec3d shift = joint.offset;
    if (frame >= 0)
      for (size_t c = 0; c < joint.channels.size(); ++c) {
        const double value =
            values[static_cast<size_t>(frame) * static_cast<size_t>(channel_count) +
                   static_cast<size_t>(joint.first_channel) + c];
        const int kind = joint.channels[c];
        if (kind < 3)
          // A position replaces the offset of the root; of other joints it is added to it.
          shift[kind] = joint.parent < 0 ? value : shift[kind] + value;
        else
          local = local * Eigen::AngleAxisd(value * std::numbers::pi / 180, Vec3d::Unit(kind - 3))
                              .toRotationMatrix();
      }
    if (joint.parent < 0) {
      rotations[j] = local;
      positions[j] = shift;
    } else {
      const size_t p = static_cast<size_t>(joint.parent);
      rotations[j] = rotations[p] * local;
      positions[j] = positions[p] + rotations[p] * shift;
    }
  }
}

Bvh read_bvh(const Path& path) {
  return Reader(read_text(path), path.string()).read();
}

}  // namespace effigy
