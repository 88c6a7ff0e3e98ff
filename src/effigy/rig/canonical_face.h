// MediaPipe's canonical face: the 468-vertex mesh whose vertices are the points of its landmark
// networks. It is not part of Effigy; it is read from the network files a user has.
#pragma once

#include <span>
#include <vector>

#include "effigy/base/file.h"
#include "effigy/geometry/types.h"

namespace effigy {

struct CanonicalFace {
  std::vector<Vec3f> vertices;   // 468, metres, y up, face +z
  std::vector<Vec2f> uvs;        // 468
  std::vector<Vec3i> triangles;  // 898
  bool empty() const { return vertices.empty(); }
};

// The mesh inside `bytes`, which may be geometry_pipeline_metadata_landmarks.binarypb (a protobuf,
// mediapipe/modules/face_geometry/protos/mesh_3d.proto) or any container that stores that file
// without compression: face_landmarker.task, the packed_assets.data of npm's @mediapipe/face_mesh.
// It is found by its framing: a length-delimited message with 5 floats for each of 468 vertices and
// indices of triangles. Empty when there is none; never throws.
CanonicalFace parse_canonical_face(std::span<const uint8_t> bytes);

// Looks in `models`: one of the files above, or a folder that holds one (also in its sub-folders
// @mediapipe/face_mesh and node_modules/@mediapipe/face_mesh). Empty when `models` is empty or
// nothing is found; throws Error when `models` itself is a file without the mesh.
CanonicalFace find_canonical_face(const Path& models);

}  // namespace effigy
