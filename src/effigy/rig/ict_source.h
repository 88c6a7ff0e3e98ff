// The files of ICT-FaceKit as they are, and which triangle belongs to what. Used by ict.cpp only.
#pragma once

#include "effigy/geometry/mesh.h"

namespace effigy::ict {

// What the triangles of the source mesh are (and parts of it: the index into Source::mesh.parts).
enum Group {
  kFace,   // front, ears, throat
  kSkull,  // top and back of the head, backs of the ears
  kNeck,   // lower neck down to the open ring
  kMouthSocket,
  kEyeSocketLeft,
  kEyeSocketRight,
  kGums,  // gums and tongue
  kTeeth,
  kEyeLeft,  // outer shell of the eyeball
  kEyeRight,
  kGroupCount
};

struct Source {
  Mesh mesh;                   // metres; the kept triangles only, all vertices; parts = groups
  std::vector<int> landmarks;  // 68 vertices, MultiPIE order
  std::vector<std::string> expression_names;    // 53
  std::vector<std::vector<float>> expressions;  // 3V each, metres
  std::vector<std::vector<float>> identities;   // 3V each, metres
};

// The folder that holds the neutral mesh: `folder` or folder/FaceXModel; empty when neither does.
Path find_folder(const Path& folder);
Source read_source(const Path& folder);

}  // namespace effigy::ict
