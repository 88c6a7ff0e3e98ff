// Biovision Hierarchy files: a skeleton of offsets and its motion as Euler angles.
#pragma once

#include <string>
#include <vector>

#include "effigy/base/file.h"
#include "effigy/geometry/types.h"

namespace effigy {

struct BvhJoint {
  std::string name;
  int parent = -1;               // smaller than its own number
  Vec3d offset = Vec3d::Zero();  // from the parent, in the file's unit
  std::vector<int> channels;  // 0 1 2: x y z position; 3 4 5: x y z rotation, in the file's order
  int first_channel = 0;
  bool end = false;  // an "End Site": no channels, named after its parent
};

struct Bvh {
  std::vector<BvhJoint> joints;  // parents first
  int channel_count = 0;
  double frame_seconds = 0;
  std::vector<double> values;  // [frames][channel_count], degrees and the file's unit
  int frames() const {
    return channel_count > 0 ? static_cast<int>(values.size() / static_cast<size_t>(channel_count))
                             : 0;
  }
  int joint(const std::string& name) const;  // -1 when absent

  // Rotations (world from joint) and positions of every joint at a frame; frame -1: the rest pose.
  void pose(int frame, std::vector<Mat3d>& rotations, std::vector<Vec3d>& positions) const;
};

// Throws Error naming file and line for anything that is not a sound BVH file: unbalanced braces,
// unknown channels, more than 1024 joints or a million frames, missing or non-finite numbers.
Bvh read_bvh(const Path& path);

}  // namespace effigy
