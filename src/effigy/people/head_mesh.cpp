#include "effigy/people/head_mesh.h"

#include "effigy/people/head_half.h"

namespace effigy::people {
namespace {

enum Part { kSkinPart, kEyeLeftPart, kEyeRightPart, kTeethPart, kMouthPart };

int part_of(HalfPart part, bool left) {
  switch (part) {
    case HalfPart::kEye:
      return left ? kEyeLeftPart : kEyeRightPart;
    case HalfPart::kTeeth:
      return kTeethPart;
    case HalfPart::kMouth:
      return kMouthPart;
    default:
      return kSkinPart;
  }
}

bool shares_uv(const Half& half, size_t vertex) {
  return half.vertices[vertex].side == 0 && half.behind[vertex] == 0 && half.uv[vertex].x() == 0.5;
}

HeadMesh mirror_whole(const Half& half) {
  HeadMesh head;
  Mesh& mesh = head.mesh;
  mesh.parts = {"skin", "eye_left", "eye_right", "teeth", "mouth"};
  const size_t n = half.vertices.size();
  head.vertices = half.vertices;
  std::vector<int> right(n), right_uv(n);
  for (size_t i = 0; i < n; ++i) {
    mesh.uvs.emplace_back(half.uv[i].cast<float>());
    right[i] = static_cast<int>(i);
    if (half.vertices[i].side != 0) {
      right[i] = static_cast<int>(head.vertices.size());
      HeadVertex vertex = half.vertices[i];
      vertex.p.x() = -vertex.p.x();
      vertex.side = -1;
      vertex.mirror = static_cast<int>(i);
      head.vertices.push_back(vertex);
    }
    head.vertices[i].mirror = right[i];
  }
  for (size_t i = 0; i < n; ++i) {
    right_uv[i] = static_cast<int>(i);
    if (shares_uv(half, i)) continue;
    right_uv[i] = static_cast<int>(mesh.uvs.size());
    mesh.uvs.emplace_back(1 - mesh.uvs[i].x(), mesh.uvs[i].y());
  }
  for (size_t f = 0; f < half.triangles.size(); ++f) {
    const Vec3i& t = half.triangles[f];
    mesh.triangles.push_back(t);
    mesh.uv_triangles.push_back(t);
    mesh.triangle_part.push_back(part_of(half.part[f], true));
    mesh.triangles.emplace_back(right[t[0]], right[t[2]], right[t[1]]);
    mesh.uv_triangles.emplace_back(right_uv[t[0]], right_uv[t[2]], right_uv[t[1]]);
    mesh.triangle_part.push_back(part_of(half.part[f], false));
  }
  for (const HeadVertex& vertex : head.vertices)
    for (int c = 0; c < 3; ++c) mesh.vertices.push_back(static_cast<float>(vertex.p[c] * 1e-3));
  head.neck_ring = half.neck;
  for (size_t i = half.neck.size() - 1; i-- > 1;) head.neck_ring.push_back(right[half.neck[i]]);
  return head;
}

}  // namespace

int HeadMesh::find(Region region, int ring, int index, int side) const {
  for (size_t i = 0; i < vertices.size(); ++i) {
    const HeadVertex& v = vertices[i];
    if (v.region == region && v.ring == ring && v.index == index && (v.side == side || v.side == 0))
      return static_cast<int>(i);
  }
  return -1;
}

HeadMesh build_head_mesh() {
  Half half;
  const auto mouth = add_mouth_rings(half);
  const auto eye = add_eye_rings(half);
  const auto ear = add_ear_rings(half);
  const auto nostril = add_nostril_rings(half);
  add_skin(half, mouth, eye, ear, nostril);
  add_eyeball(half);
  add_teeth(half);
  add_tongue(half);
  return mirror_whole(half);
}

const HeadMesh& shared_head_mesh() {
  static const HeadMesh head = build_head_mesh();
  return head;
}

}  // namespace effigy::people
