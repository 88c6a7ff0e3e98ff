// The built-in head: what makes it usable as a rig, and what makes it a head.

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <set>

#include "effigy/geometry/atlas.h"
#include "effigy/geometry/topology.h"
#include "effigy/people/builtin_head.h"
#include "effigy/people/head_mesh.h"
#include "effigy/people/head_shape.h"
#include "effigy/rays/ray_scene.h"

namespace effigy {
namespace {

using people::HeadMesh;
using people::HeadVertex;
using people::Region;

const Rig& rig() {
  static const Rig made = builtin_head_rig();
  return made;
}
const HeadMesh& head() {
  return people::shared_head_mesh();
}

std::vector<float> posed(const std::vector<std::pair<std::string, float>>& expression) {
  RigPose pose = RigPose::rest(rig());
  for (const auto& [name, value] : expression) {
    const int e = rig().expression(name);
    EXPECT_GE(e, 0) << name;
    if (e >= 0) pose.expression[e] = value;
  }
  std::vector<float> vertices;
  pose_vertices(shape_rig(rig(), {}), pose, vertices);
  return vertices;
}

Vec3f point(const std::vector<float>& values, int i) {
  return Vec3f(values.data() + 3 * i);
}

std::vector<Vec3i> triangles_of(const std::set<std::string>& parts) {
  std::vector<Vec3i> out;
  for (int f = 0; f < rig().mesh.triangle_count(); ++f)
    if (parts.count(rig().mesh.parts[rig().mesh.triangle_part[f]]) != 0)
      out.push_back(rig().mesh.triangles[f]);
  return out;
}

TEST(BuiltinHead, SkinIsClosedButForTheNeck) {
  const auto skin = triangles_of({"skin", "mouth"});
  // The tongue is a piece of its own inside the mouth.
  const auto pieces = connected_pieces(skin, rig().mesh.vertex_count());
  std::vector<Vec3i> body;
  for (const Vec3i& t : skin)
    if (pieces[t[0]] == pieces[rig().neck_ring[0]]) body.push_back(t);
  const auto loops = boundary_loops(body, rig().mesh.vertex_count());
  ASSERT_EQ(loops.size(), 1u);
  EXPECT_EQ(std::set<int>(loops[0].begin(), loops[0].end()),
            std::set<int>(rig().neck_ring.begin(), rig().neck_ring.end()));
  EXPECT_EQ(loops[0].size(), rig().neck_ring.size());

  // Every directed edge once: consistently oriented. Euler: a disc (one boundary) has V - E + F
  // = 1.
  std::set<std::pair<int, int>> directed, undirected;
  std::set<int> used;
  for (const Vec3i& t : body)
    for (int k = 0; k < 3; ++k) {
      const int a = t[k], b = t[(k + 1) % 3];
      EXPECT_TRUE(directed.insert({a, b}).second);
      undirected.insert(std::minmax(a, b));
      used.insert(a);
    }
  EXPECT_EQ(static_cast<int>(used.size()) - static_cast<int>(undirected.size()) +
                static_cast<int>(body.size()),
            1);
}

TEST(BuiltinHead, NeckRingIsALoopOfEdges) {
  std::set<std::pair<int, int>> edges;
  for (const auto& [a, b] : mesh_edges(rig().mesh.triangles, rig().mesh.vertex_count()))
    edges.insert(std::minmax(a, b));
  const auto& ring = rig().neck_ring;
  for (size_t i = 0; i < ring.size(); ++i) {
    const int a = ring[i], b = ring[(i + 1) % ring.size()];
    EXPECT_EQ(edges.count(std::minmax(a, b)), 1u) << i;
  }
}

TEST(BuiltinHead, HasAHumanSizeAndEvenTriangles) {
  const Mesh& mesh = rig().mesh;
  // About FLAME's 9976.
  EXPECT_GE(mesh.triangle_count(), 8000);
  EXPECT_LE(mesh.triangle_count(), 11000);
  float crown = -1, left = 0, front = -1, back = 1;
  for (int v = 0; v < mesh.vertex_count(); ++v) {
    const HeadVertex& what = head().vertices[v];
    const Vec3f p = mesh.vertex(v);
    crown = std::max(crown, p.y());
    back = std::min(back, p.z());
    front = std::max(front, p.z());
    if (what.region == Region::kSkin && p.y() > 0) left = std::max(left, p.x());
  }
  const auto marks = landmark_positions(rig().multipie, mesh.triangles, mesh.vertices);
  const float chin = point(marks, 8).y();
  EXPECT_NEAR(crown - chin, 0.232, 0.012);  // vertex to menton
  EXPECT_NEAR(2 * left, 0.156, 0.012);      // breadth, with short hair
  EXPECT_NEAR(front - back, 0.222, 0.018);  // tip of the nose to the back
  // Between the outer corners of the eyes; breadth of the mouth.
  EXPECT_NEAR(point(marks, 45).x() - point(marks, 36).x(), 0.092, 0.006);
  EXPECT_NEAR(point(marks, 54).x() - point(marks, 48).x(), 0.050, 0.006);

  std::vector<double> areas;
  double total = 0;
  for (int f = 0; f < mesh.triangle_count(); ++f) {
    const Vec3i& t = mesh.triangles[f];
    const Vec3f a = mesh.vertex(t[0]), b = mesh.vertex(t[1]), c = mesh.vertex(t[2]);
    if (mesh.triangle_part[f] != 0 || a.z() < 0.04f || a.y() < -0.11f || a.y() > 0.06f) continue;
    areas.push_back(0.5e6 * static_cast<double>((b - a).cross(c - a).norm()));
    total += areas.back();
  }
  EXPECT_GT(total / static_cast<double>(areas.size()), 10.0);
  EXPECT_LT(total / static_cast<double>(areas.size()), 20.0);
  std::sort(areas.begin(), areas.end());
  EXPECT_GT(areas.front(), 0.05);
  EXPECT_LT(areas[areas.size() * 95 / 100], 32.0);
}

TEST(BuiltinHead, AtlasHasNoOverlapsAndFavoursTheFace) {
  const AtlasReport report = inspect_atlas(rig().mesh, 512);
  EXPECT_EQ(report.overlaps, 0);
  EXPECT_EQ(report.clockwise, 0);
  EXPECT_GT(report.coverage, 0.8);
  for (const Vec2f& uv : rig().mesh.uvs) {
    EXPECT_GT(uv.minCoeff(), 0.0f);
    EXPECT_LT(uv.maxCoeff(), 1.0f);
  }
  // UV area per surface area: the face against the rest of the skin.
  double uv_face = 0, uv_rest = 0, face = 0, rest = 0;
  for (int f = 0; f < rig().mesh.triangle_count(); ++f) {
    const Vec3i &t = rig().mesh.triangles[f], &u = rig().mesh.uv_triangles[f];
    if (rig().mesh.triangle_part[f] != 0) continue;
    const Vec3f a = rig().mesh.vertex(t[0]);
    const Vec2f p = rig().mesh.uvs[u[1]] - rig().mesh.uvs[u[0]],
                q = rig().mesh.uvs[u[2]] - rig().mesh.uvs[u[0]];
    const double uv = 0.5 * static_cast<double>(p.x() * q.y() - p.y() * q.x());
    const double area =
        0.5 * static_cast<double>(
                  (rig().mesh.vertex(t[1]) - a).cross(rig().mesh.vertex(t[2]) - a).norm());
    const bool on_face = a.z() > 0.03f && a.y() > -0.12f && a.y() < 0.062f;
    (on_face ? uv_face : uv_rest) += uv;
    (on_face ? face : rest) += area;
  }
  EXPECT_GT(uv_face / face, 1.8 * uv_rest / rest);
}

TEST(BuiltinHead, RigIsSoundAndJointsLieWhereTheyShould) {
  check_rig(rig(), "built-in head");
  EXPECT_EQ(rig().joint_names,
            (std::vector<std::string>{"root", "neck", "jaw", "eye_left", "eye_right"}));
  EXPECT_GE(rig().identity_count, 20);
  EXPECT_GE(rig().expression_count, 52);
  const RigShape shape = shape_rig(rig(), {});
  const Vec3f eye(people::kEyeX, people::kEyeY, people::kEyeZ);
  EXPECT_LT((point(shape.joints, 3) * 1000 - eye).norm(), 0.05f);
  EXPECT_LT((point(shape.joints, 4) * 1000 - Vec3f(-eye.x(), eye.y(), eye.z())).norm(), 0.05f);
  // The eyeball turns about its own centre: it stays where it is, but its front goes sideways.
  RigPose pose = RigPose::rest(rig());
  pose.joint_rotation[3 * 3 + 1] = 0.4f;
  std::vector<float> vertices;
  pose_vertices(shape, pose, vertices);
  for (size_t v = 0; v < head().vertices.size(); ++v)
    if (head().vertices[v].region == Region::kEyeball && head().vertices[v].side > 0) {
      EXPECT_NEAR((point(vertices, static_cast<int>(v)) * 1000 - eye).norm(), people::kEyeRadius,
                  people::kCorneaHeight + 0.05);
    }
}

TEST(BuiltinHead, IsMirrorSymmetric) {
  for (size_t v = 0; v < head().vertices.size(); ++v) {
    const int m = head().vertices[v].mirror;
    const Vec3f p = head().mesh.vertex(static_cast<int>(v)), q = head().mesh.vertex(m);
    ASSERT_LT((Vec3f(-p.x(), p.y(), p.z()) - q).norm(), 1e-6f);
  }
  const size_t stride = rig().mesh.vertices.size();
  for (int e = 0; e < rig().expression_count; ++e) {
    std::string name = rig().expression_names[e];
    if (!name.ends_with("_L")) continue;
    const int other = rig().expression(name.substr(0, name.size() - 2) + "_R");
    ASSERT_GE(other, 0) << name;
    for (size_t v = 0; v < head().vertices.size(); ++v) {
      const float* d = &rig().expression_basis[static_cast<size_t>(e) * stride + 3 * v];
      const float* m = &rig().expression_basis[static_cast<size_t>(other) * stride +
                                               3 * static_cast<size_t>(head().vertices[v].mirror)];
      ASSERT_NEAR(d[0], -m[0], 2e-5f) << name;
      ASSERT_NEAR(d[1], m[1], 2e-5f) << name;
    }
  }
}

// Left is +x: the left blink moves the left eye's lids only.
TEST(BuiltinHead, LeftIsTheSubjectsLeft) {
  const auto rest = posed({}), blink = posed({{"eyeBlink_L", 1.0f}});
  for (int v = 0; v < rig().mesh.vertex_count(); ++v)
    if ((point(blink, v) - point(rest, v)).norm() > 1e-4f) {
      EXPECT_GT(point(rest, v).x(), 0);
    }
}

// Rays from the front onto the openings of the eyes.
int visible_eyeball_rays(const std::vector<float>& vertices) {
  const RayScene scene(vertices, rig().mesh.triangles);
  int seen = 0;
  for (int x = -200; x <= 200; ++x)
    for (int y = -120; y <= 120; ++y) {
      const RayHit hit = scene.closest({0.0315f + 1e-4f * x, 1e-4f * y, 0.3f}, {0, 0, -1});
      if (hit.triangle >= 0 && rig().mesh.triangle_part[hit.triangle] == 1) ++seen;
    }
  return seen;
}

TEST(BuiltinHead, BlinkClosesTheLids) {
  const int open = visible_eyeball_rays(posed({}));
  EXPECT_GT(open, 10000);  // of 0.01 mm^2: more than 100 mm^2
  EXPECT_EQ(visible_eyeball_rays(posed({{"eyeBlink_L", 1.0f}})), 0);
  const int half = visible_eyeball_rays(posed({{"eyeBlink_L", 0.5f}}));
  EXPECT_LT(half, 0.65 * open);
  EXPECT_GT(half, 0.2 * open);
  EXPECT_GT(visible_eyeball_rays(posed({{"eyeWide_L", 1.0f}})), 1.15 * open);
}

TEST(BuiltinHead, LidsStayOutsideTheEyeball) {
  const Vec3f eye(people::kEyeX, people::kEyeY, people::kEyeZ);
  for (int step = 0; step <= 8; ++step) {
    const auto vertices = posed({{"eyeBlink_L", static_cast<float>(step) / 8}});
    for (size_t v = 0; v < head().vertices.size(); ++v)
      if (head().vertices[v].region == Region::kEyeRing && head().vertices[v].side > 0) {
        // The hidden inner edge may touch the ball, what is seen must not.
        const double least = head().vertices[v].ring >= 0 ? 12.4 : 11.8;
        EXPECT_GT((point(vertices, static_cast<int>(v)) * 1000 - eye).norm(), least)
            << "ring " << head().vertices[v].ring << " at " << step;
      }
  }
}

TEST(BuiltinHead, JawOpensTheMouth) {
  auto gap = [](const std::vector<float>& vertices) {
    const auto marks = landmark_positions(rig().multipie, rig().mesh.triangles, vertices);
    return point(marks, 62).y() - point(marks, 66).y();
  };
  EXPECT_LT(std::abs(gap(posed({}))), 0.001f);
  EXPECT_GT(gap(posed({{"jawOpen", 1.0f}})), 0.022f);
  EXPECT_LT(gap(posed({{"jawOpen", 1.0f}})), 0.060f);
  // mouthClose undoes it at the lips, and the jaw joint opens it too.
  EXPECT_LT(gap(posed({{"jawOpen", 1.0f}, {"mouthClose", 1.0f}})), 0.012f);
  RigPose pose = RigPose::rest(rig());
  pose.joint_rotation[3 * 2] = 0.3f;
  std::vector<float> vertices;
  pose_vertices(shape_rig(rig(), {}), pose, vertices);
  EXPECT_GT(gap(vertices), 0.02f);
}

TEST(BuiltinHead, LandmarksAreInOrder) {
  ASSERT_EQ(rig().multipie.size(), 68u);
  const auto marks = landmark_positions(rig().multipie, rig().mesh.triangles, rig().mesh.vertices);
  for (int i = 0; i < 68; ++i) ASSERT_EQ(rig().multipie.index[i], i);
  // The jaw runs from the subject's right (-x) over the chin to the left.
  for (int i = 1; i < 17; ++i) EXPECT_GT(point(marks, i).x(), point(marks, i - 1).x());
  for (int i = 18; i < 27; ++i) EXPECT_GT(point(marks, i).x(), point(marks, i - 1).x());
  for (int i = 28; i < 31; ++i) EXPECT_LT(point(marks, i).y(), point(marks, i - 1).y());
  for (const auto& [low, high] : {std::pair{41, 37}, {40, 38}, {47, 43}, {46, 44}, {57, 51}})
    EXPECT_LT(point(marks, low).y(), point(marks, high).y());
  for (const auto& [right, left] : {std::pair{36, 39}, {42, 45}, {48, 54}, {60, 64}, {31, 35}})
    EXPECT_LT(point(marks, right).x(), point(marks, left).x());
  EXPECT_GE(rig().mediapipe.size(), 68u);
}

TEST(BuiltinHead, NetworkPointsLieWhereTheyBelong) {
  const LandmarkEmbedding points = builtin_head_network_points();
  const auto marks = landmark_positions(rig().multipie, rig().mesh.triangles, rig().mesh.vertices);
  ASSERT_EQ(points.size(), 478u);
  // Known places among the network's points: tip of the nose, chin, outer corners of the eyes,
  // corners of the mouth, the middle of both lips' inner rims.
  const auto net = landmark_positions(points, rig().mesh.triangles, rig().mesh.vertices);
  for (int i = 0; i < 478; ++i) ASSERT_EQ(points.index[i], i);
  for (const auto& [point_number, landmark] :
       {std::pair{33, 36}, {263, 45}, {78, 60}, {308, 64}, {13, 62}, {14, 66}, {2, 33}, {152, 8}})
    EXPECT_LT((point(net, point_number) - point(marks, landmark)).norm(), 0.006f) << point_number;
  EXPECT_GT(point(net, 4).z(), point(net, 0).z());
  // With the jaw open the inner rims part.
  const auto open = landmark_positions(points, rig().mesh.triangles, posed({{"jawOpen", 1.0f}}));
  EXPECT_GT(point(open, 13).y() - point(open, 14).y(), 0.02f);
}

TEST(BuiltinHead, IsDeterministic) {
  const HeadMesh a = people::build_head_mesh();
  EXPECT_EQ(a.mesh.vertices, head().mesh.vertices);
  ASSERT_EQ(a.mesh.triangles.size(), head().mesh.triangles.size());
  for (size_t f = 0; f < a.mesh.triangles.size(); ++f)
    ASSERT_EQ(a.mesh.triangles[f], head().mesh.triangles[f]);
}

}  // namespace
}  // namespace effigy
