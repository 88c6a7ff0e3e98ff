#include "effigy/rig/ict.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/geometry/atlas.h"
#include "effigy/geometry/decimate.h"
#include "effigy/rig/canonical_face.h"
#include "effigy/rig/embedding.h"
#include "effigy/rig/embedding_surface.h"
#include "effigy/rig/ict_joints.h"
#include "effigy/rig/ict_source.h"

namespace effigy {

namespace {

using ict::Source;

// The wanted edge length of each group, metres. A face triangle then has about 17 mm2.
constexpr std::array<float, ict::kGroupCount> kEdge = {7.6e-3f, 10e-3f, 10e-3f, 9e-3f, 7e-3f,
                                                       7e-3f,   9e-3f,  7e-3f,  4e-3f, 4e-3f};
// Texels per metre of each group, relative to the face.
constexpr std::array<float, ict::kGroupCount> kDensity = {1.f,  0.28f, 0.33f, 0.3f, 0.2f,
                                                          0.2f, 0.28f, 0.35f, 0.7f, 0.7f};
// Edges grow from the first to the group's length within the second, metres, from lids and lips.
constexpr float kContourEdge = 3.2e-3f;
constexpr float kContourReach = 16e-3f;
// How far the surface of each group may move, metres.
constexpr std::array<float, ict::kGroupCount> kTolerance = {3.5e-4f, 8e-4f, 8e-4f,   1e-3f, 1e-3f,
                                                            1e-3f,   7e-4f, 1.1e-3f, 3e-4f, 3e-4f};
constexpr int kFirstContourLandmark = 36;  // 36-47 lids, 48-67 lips
constexpr int kFirstOuterLip = 48, kFirstInnerLip = 60, kLandmarks = 68;

// The deformations whose surfaces decimation must keep: the strongest shapes, left and right
// together because they do not meet.
constexpr std::array<std::array<const char*, 4>, 7> kPoses = {{
    {"jawOpen", "", "", ""},
    {"eyeBlink_L", "eyeBlink_R", "mouthPucker", ""},
    {"mouthSmile_L", "mouthSmile_R", "browDown_L", "browDown_R"},
    {"jawOpen", "mouthUpperUp_L", "mouthUpperUp_R", "eyeSquint_L"},
    {"mouthFunnel", "browInnerUp_L", "browInnerUp_R", "eyeSquint_R"},
    {"cheekPuff_L", "cheekPuff_R", "mouthRollLower", "mouthRollUpper"},
    {"mouthStretch_L", "mouthStretch_R", "noseSneer_L", "noseSneer_R"},
}};

std::vector<std::vector<float>> test_poses(const Source& source) {
  std::vector<std::vector<float>> poses;
  for (const auto& names : kPoses) {
    std::vector<float> pose = source.mesh.vertices;
    for (const char* name : names) {
      const auto found =
          std::find(source.expression_names.begin(), source.expression_names.end(), name);
      if (found == source.expression_names.end()) continue;
      const std::vector<float>& delta =
          source.expressions[static_cast<size_t>(found - source.expression_names.begin())];
      for (size_t i = 0; i < pose.size(); ++i) pose[i] += delta[i];
    }
    poses.push_back(std::move(pose));
  }
  return poses;
}

// Closed polylines through the landmarks of both lids, the outer and the inner lip contour.
std::vector<std::pair<Vec3f, Vec3f>> contour_segments(const Source& source) {
  std::vector<std::pair<Vec3f, Vec3f>> segments;
  const int loops[5] = {kFirstContourLandmark, 42, kFirstOuterLip, kFirstInnerLip, kLandmarks};
  for (int loop = 0; loop < 4; ++loop)
    for (int i = loops[loop]; i < loops[loop + 1]; ++i) {
      const int next = i + 1 < loops[loop + 1] ? i + 1 : loops[loop];
      segments.emplace_back(source.mesh.vertex(source.landmarks[static_cast<size_t>(i)]),
                            source.mesh.vertex(source.landmarks[static_cast<size_t>(next)]));
    }
  return segments;
}

// The smallest value of the groups that meet at each vertex.
std::vector<float> least_of_groups(const Mesh& mesh,
                                   const std::array<float, ict::kGroupCount>& value) {
  std::vector<float> out(static_cast<size_t>(mesh.vertex_count()), 1.f);
  for (size_t t = 0; t < mesh.triangles.size(); ++t)
    for (int k = 0; k < 3; ++k) {
      float& x = out[static_cast<size_t>(mesh.triangles[t][k])];
      x = std::min(x, value[static_cast<size_t>(mesh.triangle_part[t])]);
    }
  return out;
}

std::vector<float> size_field(const Source& source) {
  const Mesh& mesh = source.mesh;
  std::vector<float> size = least_of_groups(mesh, kEdge);
  const std::vector<std::pair<Vec3f, Vec3f>> segments = contour_segments(source);
  // Only what lids and lips are made of: the face and the first rows of the sockets.
  std::vector<uint8_t> near(size.size(), 0);
  for (size_t t = 0; t < mesh.triangles.size(); ++t)
    if (mesh.triangle_part[t] == ict::kFace)
      for (int k = 0; k < 3; ++k) near[static_cast<size_t>(mesh.triangles[t][k])] = 1;
  for (size_t v = 0; v < size.size(); ++v) {
    if (!near[v]) continue;
    const Vec3f p = mesh.vertex(static_cast<int>(v));
    float distance = kContourReach;
    for (const auto& [a, b] : segments) {
      const Vec3f along = b - a;
      const float s = std::clamp((p - a).dot(along) / along.squaredNorm(), 0.f, 1.f);
      distance = std::min(distance, (a + s * along - p).norm());
    }
    size[v] = std::min(size[v], kContourEdge + (size[v] - kContourEdge) * distance / kContourReach);
  }
  return size;
}

// The rims of the lids, which are edge loops of the source mesh, as chains of edges.
std::vector<std::pair<int, int>> lid_rims(const Source& source) {
  const std::vector<std::vector<int>> arcs = {
      {36, 37, 38, 39}, {36, 41, 40, 39}, {42, 43, 44, 45}, {42, 47, 46, 45}};
  const embedding::EdgeGraph graph = embedding::edge_graph(source.mesh, "face");
  std::vector<std::pair<int, int>> edges;
  for (const std::vector<int>& arc : arcs) {
    std::vector<int> stops;
    for (const int i : arc) stops.push_back(source.landmarks[static_cast<size_t>(i)]);
    const std::vector<int> path = embedding::walk_through(source.mesh, graph, stops);
    for (size_t i = 1; i < path.size(); ++i) edges.emplace_back(path[i - 1], path[i]);
  }
  return edges;
}

Decimated simplify(const Source& source) {
  DecimateOptions options;
  options.creases = lid_rims(source);
  options.poses = test_poses(source);
  options.size = size_field(source);
  options.vertex_tolerance = least_of_groups(source.mesh, kTolerance);
  options.locked.assign(options.size.size(), 0);
  for (const int v : source.landmarks) options.locked[static_cast<size_t>(v)] = 1;
  return decimate(source.mesh, options);
}

// The rows of the kept vertices of each shape, one after another.
std::vector<float> gather(const std::vector<std::vector<float>>& shapes,
                          const std::vector<int>& vertices) {
  std::vector<float> out;
  out.reserve(shapes.size() * vertices.size() * 3);
  for (const std::vector<float>& shape : shapes)
    for (const int v : vertices)
      for (size_t k = 0; k < 3; ++k) out.push_back(shape[3 * static_cast<size_t>(v) + k]);
  return out;
}

LandmarkEmbedding vertex_landmarks(const Mesh& mesh, const std::vector<int>& kept,
                                   const std::vector<int>& landmarks) {
  LandmarkEmbedding out;
  for (size_t i = 0; i < landmarks.size(); ++i) {
    const auto place = std::lower_bound(kept.begin(), kept.end(), landmarks[i]);
    EFFIGY_CHECK(place != kept.end() && *place == landmarks[i]);
    const int v = static_cast<int>(place - kept.begin());
    for (size_t t = 0; t < mesh.triangles.size(); ++t) {
      const Vec3i& f = mesh.triangles[t];
      if (f[0] != v && f[1] != v && f[2] != v) continue;
      out.index.push_back(static_cast<int>(i));
      out.triangle.push_back(static_cast<int>(t));
      out.barycentric.emplace_back(f[0] == v ? 1.f : 0.f, f[1] == v ? 1.f : 0.f,
                                   f[2] == v ? 1.f : 0.f);
      break;
    }
  }
  return out;
}

// Groups become the parts that all rigs share.
void name_parts(Mesh& mesh) {
  mesh.parts = {"skin", "eye_left", "eye_right", "teeth", "mouth"};
  constexpr std::array<int, ict::kGroupCount> kPart = {0, 0, 0, 4, 4, 4, 4, 3, 1, 2};
  for (int& part : mesh.triangle_part) part = kPart[static_cast<size_t>(part)];
}

}  // namespace

bool is_ict_folder(const Path& folder) {
  const Path place = ict::find_folder(folder);
  std::error_code ignored;
  return !place.empty() && std::filesystem::is_regular_file(place / "vertex_indices.json", ignored);
}

Rig load_ict(const Path& folder, const Path& models) {
  const Source source = ict::read_source(folder);
  Decimated small = simplify(source);
  AtlasOptions atlas;
  atlas.density.assign(kDensity.begin(), kDensity.end());
  pack_atlas(small.mesh, atlas);

  Rig rig;
  rig.kind = "ict-facekit";
  rig.licence = "MIT";
  rig.mesh = std::move(small.mesh);
  rig.identity_count = static_cast<int>(source.identities.size());
  rig.identity_basis = gather(source.identities, small.vertex);
  rig.identity_sigma.assign(source.identities.size(), 1.f);
  rig.expression_count = static_cast<int>(source.expressions.size());
  rig.expression_basis = gather(source.expressions, small.vertex);
  rig.expression_names = source.expression_names;
  rig.expression_low.assign(source.expressions.size(), 0.f);
  rig.expression_high.assign(source.expressions.size(), 1.f);
  rig.multipie = vertex_landmarks(rig.mesh, small.vertex, source.landmarks);
  name_parts(rig.mesh);
  ict::add_joints(rig);
  const CanonicalFace canonical = find_canonical_face(models);
  rig.mediapipe = canonical.empty() ? embed_corresponding(rig) : embed_canonical(rig, canonical);
  check_rig(rig, folder.string());
  return rig;
}

}  // namespace effigy
