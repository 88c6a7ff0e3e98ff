#include "effigy/rig/ict.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <fstream>
#include <map>
#include <set>

#include "effigy/base/error.h"
#include "effigy/geometry/atlas.h"
#include "effigy/geometry/topology.h"
#include "effigy/rig/rig_file.h"

namespace effigy {
namespace {

Path data_folder() {
  const char* data = std::getenv("EFFIGY_DATA");
  return data ? Path(data) / "face" / "ict_facekit" : Path();
}

class IctData : public testing::Test {
 protected:
  void SetUp() override {
    if (!is_ict_folder(data_folder()))
      GTEST_SKIP() << "ICT-FaceKit is not there; set EFFIGY_DATA to a folder with "
                      "face/ict_facekit to run this test.";
    static const Rig kRig = load_ict(data_folder(), Path(std::getenv("EFFIGY_DATA")) / "models");
    rig = &kRig;
  }

  // Positions after setting some expressions to 1, or turning a joint.
  std::vector<float> posed(const std::vector<std::string>& expressions, int joint = 0,
                           const Vec3f& turn = Vec3f::Zero()) const {
    RigPose pose = RigPose::rest(*rig);
    for (const std::string& name : expressions) {
      EXPECT_GE(rig->expression(name), 0) << name;
      pose.expression[static_cast<size_t>(rig->expression(name))] = 1;
    }
    for (int k = 0; k < 3; ++k) pose.joint_rotation[static_cast<size_t>(3 * joint + k)] = turn[k];
    std::vector<float> out;
    pose_vertices(shape_rig(*rig, {}), pose, out);
    return out;
  }
  Vec3f landmark(const std::vector<float>& vertices, size_t index) const {
    const std::vector<float> all = landmark_positions(rig->multipie, rig->mesh.triangles, vertices);
    return Vec3f(all.data() + 3 * index);
  }
  int part(const std::string& name) const {
    for (size_t i = 0; i < rig->mesh.parts.size(); ++i)
      if (rig->mesh.parts[i] == name) return static_cast<int>(i);
    return -1;
  }
  std::set<int> vertices_of(const std::string& name) const {
    std::set<int> out;
    for (size_t t = 0; t < rig->mesh.triangles.size(); ++t)
      if (rig->mesh.triangle_part[t] == part(name))
        for (int k = 0; k < 3; ++k) out.insert(rig->mesh.triangles[t][k]);
    return out;
  }
  Vec3f joint(int j) const {
    return Vec3f(shape_rig(*rig, {}).joints.data() + 3 * static_cast<size_t>(j));
  }

  const Rig* rig = nullptr;
};

double area(const Mesh& mesh, size_t t) {
  const Vec3i& f = mesh.triangles[t];
  return 0.5 * static_cast<double>((mesh.vertex(f[1]) - mesh.vertex(f[0]))
                                       .cross(mesh.vertex(f[2]) - mesh.vertex(f[0]))
                                       .norm());
}

TEST_F(IctData, HasWhatARigNeeds) {
  check_rig(*rig, "ict");
  EXPECT_EQ(rig->kind, "ict-facekit");
  EXPECT_EQ(rig->licence, "MIT");
  EXPECT_EQ(rig->identity_count, 20);
  EXPECT_EQ(rig->expression_count, 53);
  EXPECT_EQ(rig->multipie.size(), 68u);
  EXPECT_EQ(rig->joint_names, (std::vector<std::string>{"root", "neck", "eye_left", "eye_right"}));
  for (const char* name : {"skin", "eye_left", "eye_right", "teeth", "mouth"})
    EXPECT_FALSE(vertices_of(name).empty()) << name;
  for (const float high : rig->expression_high) EXPECT_EQ(high, 1);
}

TEST_F(IctData, IsLoadedAndStoredLikeAnyRig) {
  const Rig loaded = load_rig(data_folder(), {});
  EXPECT_EQ(loaded.kind, "ict-facekit");
  EXPECT_EQ(loaded.mesh.vertices, rig->mesh.vertices);  // deterministic
  EXPECT_EQ(loaded.mesh.uvs, rig->mesh.uvs);
  const Path file = Path(testing::TempDir()) / "effigy_ict_rig.safetensors";
  write_rig(file, *rig);
  const Rig back = read_rig(file);
  EXPECT_EQ(back.mesh.triangles, rig->mesh.triangles);
  EXPECT_EQ(back.weights, rig->weights);
  EXPECT_EQ(back.mediapipe.index, rig->mediapipe.index);
  std::filesystem::remove(file);
}

TEST_F(IctData, TrianglesHaveFlameSize) {
  const Mesh& mesh = rig->mesh;
  EXPECT_GT(mesh.triangle_count(), 8000);
  EXPECT_LT(mesh.triangle_count(), 12500);
  // The face proper: skin in front of the ears and above the throat.
  double sum = 0;
  int count = 0;
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    const Vec3i& f = mesh.triangles[t];
    const Vec3f c = (mesh.vertex(f[0]) + mesh.vertex(f[1]) + mesh.vertex(f[2])) / 3;
    if (mesh.triangle_part[t] != part("skin") || c.z() < 0.03f || c.y() < -0.08f) continue;
    sum += area(mesh, t);
    ++count;
  }
  EXPECT_GT(sum / count, 12e-6);
  EXPECT_LT(sum / count, 22e-6);
}

TEST_F(IctData, MeshIsManifoldAndOpenAtTheNeckOnly) {
  const Mesh& mesh = rig->mesh;
  std::map<std::pair<int, int>, int> directed;
  for (const Vec3i& f : mesh.triangles)
    for (int k = 0; k < 3; ++k) ++directed[{f[k], f[(k + 1) % 3]}];
  for (const auto& [edge, count] : directed) EXPECT_EQ(count, 1);
  const auto loops = boundary_loops(mesh.triangles, mesh.vertex_count());
  EXPECT_EQ(loops.size(), 3u);  // the neck; the backs of the gums and of the tongue
  ASSERT_GT(rig->neck_ring.size(), 20u);
  for (size_t i = 0; i < rig->neck_ring.size(); ++i) {
    const int a = rig->neck_ring[i], b = rig->neck_ring[(i + 1) % rig->neck_ring.size()];
    EXPECT_EQ(directed.count({a, b}) + directed.count({b, a}), 1u);  // neighbours on the boundary
    EXPECT_LT(mesh.vertex(a).y(), -0.12f);
  }
  for (size_t t = 0; t < mesh.triangles.size(); ++t) EXPECT_GT(area(mesh, t), 0);
}

TEST_F(IctData, AtlasHasNoOverlapsAndIsMostlyFace) {
  const AtlasReport report = inspect_atlas(rig->mesh, 1024);
  EXPECT_EQ(report.overlaps, 0);
  EXPECT_EQ(report.clockwise, 0);
  EXPECT_GT(report.coverage, 0.75);
  const std::vector<int> island = uv_islands(rig->mesh);
  std::map<int, double> uv_area;
  for (size_t t = 0; t < island.size(); ++t) {
    const Vec3i& u = rig->mesh.uv_triangles[t];
    const Vec2f a = rig->mesh.uvs[static_cast<size_t>(u[0])];
    const Vec2f e = rig->mesh.uvs[static_cast<size_t>(u[1])] - a;
    const Vec2f g = rig->mesh.uvs[static_cast<size_t>(u[2])] - a;
    uv_area[island[t]] += 0.5 * static_cast<double>(e.x() * g.y() - e.y() * g.x());
  }
  double largest = 0;
  for (const auto& [i, a] : uv_area) largest = std::max(largest, a);
  EXPECT_GT(largest, 0.6);
}

TEST_F(IctData, LeftIsPlusX) {
  EXPECT_GT(joint(rig->joint("eye_left")).x(), 0.02f);
  EXPECT_LT(joint(rig->joint("eye_right")).x(), -0.02f);
  EXPECT_GT(landmark(rig->mesh.vertices, 45).x(), 0.03f);  // outer corner of the left eye
  EXPECT_GT(landmark(rig->mesh.vertices, 30).z(), 0.12f);  // nose tip
}

TEST_F(IctData, JawOpens) {
  const std::vector<float>& rest = rig->mesh.vertices;
  const std::vector<float> open = posed({"jawOpen"});
  EXPECT_LT(landmark(open, 8).y(), landmark(rest, 8).y() - 0.02f);     // chin
  EXPECT_LT(landmark(open, 66).y(), landmark(rest, 66).y() - 0.015f);  // lower lip
  EXPECT_NEAR(landmark(open, 30).y(), landmark(rest, 30).y(), 2e-3);   // nose
  EXPECT_NEAR(landmark(open, 62).y(), landmark(rest, 62).y(), 8e-3);   // upper lip
  // Lower teeth go along: some of them, not all.
  int moved = 0, stayed = 0;
  for (const int v : vertices_of("teeth")) {
    const float down = rest[static_cast<size_t>(3 * v + 1)] - open[static_cast<size_t>(3 * v + 1)];
    moved += down > 0.01f;
    stayed += std::abs(down) < 1e-3f;
  }
  EXPECT_GT(moved, 100);
  EXPECT_GT(stayed, 100);
  // Mouth closed again by its own shape, lips meet.
  const std::vector<float> closed = posed({"jawOpen", "mouthClose"});
  EXPECT_LT(landmark(closed, 62).y() - landmark(closed, 66).y(), 2e-3f);
}

TEST_F(IctData, LidsClose) {
  const std::vector<float>& rest = rig->mesh.vertices;
  const std::vector<float> shut = posed({"eyeBlink_L", "eyeBlink_R"});
  for (const auto& [upper, lower] : {std::pair{37, 41}, {38, 40}, {43, 47}, {44, 46}}) {
    const auto gap = [&](const std::vector<float>& x) {
      return (landmark(x, static_cast<size_t>(upper)) - landmark(x, static_cast<size_t>(lower)))
          .norm();
    };
    EXPECT_GT(gap(rest), 6e-3f);
    EXPECT_LT(gap(shut), 2e-3f);
  }
  // One lid leaves the other alone, and nothing of it moves the eyeballs.
  const std::vector<float> wink = posed({"eyeBlink_L"});
  EXPECT_LT((landmark(wink, 37) - landmark(rest, 37)).norm(), 1e-4f);
  EXPECT_GT((landmark(wink, 43) - landmark(rest, 43)).norm(), 4e-3f);
  for (const char* eye : {"eye_left", "eye_right"})
    for (const int v : vertices_of(eye))
      for (int k = 0; k < 3; ++k)
        EXPECT_NEAR(shut[static_cast<size_t>(3 * v + k)], rest[static_cast<size_t>(3 * v + k)],
                    1e-5);
}

TEST_F(IctData, EyesTurnAboutTheirCentres) {
  for (const char* name : {"eye_left", "eye_right"}) {
    const int j = rig->joint(name);
    const Vec3f center = joint(j);
    // A sphere behind the cornea: the back half is equally far everywhere.
    double least = 1, most = 0;
    for (const int v : vertices_of(name)) {
      const Vec3f d = rig->mesh.vertex(v) - center;
      if (d.z() > 0) continue;
      least = std::min(least, static_cast<double>(d.norm()));
      most = std::max(most, static_cast<double>(d.norm()));
    }
    EXPECT_GT(least, 0.012);
    EXPECT_LT(most - least, 1.5e-3);
    const std::vector<float> turned = posed({}, j, Vec3f(0, 0.4f, 0));
    const std::set<int> own = vertices_of(name);
    for (int v = 0; v < rig->mesh.vertex_count(); ++v) {
      const Vec3f moved = Vec3f(turned.data() + 3 * v) - rig->mesh.vertex(v);
      if (own.count(v)) {
        EXPECT_NEAR((Vec3f(turned.data() + 3 * v) - center).norm(),
                    (rig->mesh.vertex(v) - center).norm(), 1e-5f);
      } else {
        EXPECT_LT(moved.norm(), 1e-6f);
      }
    }
    // Positive y turns to the subject's left.
    const std::vector<float> before =
        landmark_positions(rig->mediapipe, rig->mesh.triangles, rig->mesh.vertices);
    const std::vector<float> after =
        landmark_positions(rig->mediapipe, rig->mesh.triangles, turned);
    for (size_t i = 0; i < rig->mediapipe.size(); ++i)
      if (rig->mediapipe.index[i] == (j == rig->joint("eye_left") ? 473 : 468)) {
        EXPECT_GT(after[3 * i], before[3 * i] + 4e-3f);
      }
  }
}

TEST_F(IctData, JointsOfRegressorsAndWeights) {
  const size_t joints = static_cast<size_t>(rig->joint_count());
  const size_t count = static_cast<size_t>(rig->mesh.vertex_count());
  for (size_t j = 0; j < joints; ++j) {
    double sum = 0, largest = 0;
    int used = 0;
    for (size_t v = 0; v < count; ++v) {
      const double w = static_cast<double>(rig->joint_regressor[j * count + v]);
      sum += w;
      largest = std::max(largest, std::abs(w));
      used += w != 0;
    }
    EXPECT_NEAR(sum, 1, 1e-4);
    EXPECT_LT(largest, 0.2);
    EXPECT_LT(used, static_cast<int>(count / 4));
  }
  const Vec3f root = joint(0), neck = joint(1);
  EXPECT_LT(root.y(), -0.12f);
  EXPECT_GT(neck.y(), root.y() + 0.05f);
  EXPECT_NEAR(neck.x(), 0, 1e-4);
  // The ring stays with the root, the head goes with the neck, no step between them.
  const auto share = [&](int v) { return rig->weights[static_cast<size_t>(v) * joints + 1]; };
  for (const int v : rig->neck_ring) EXPECT_EQ(share(v), 0);
  for (const int t : rig->multipie.triangle)
    EXPECT_NEAR(share(rig->mesh.triangles[static_cast<size_t>(t)][0]), 1, 1e-6);
  const std::set<int> skin = vertices_of("skin");
  int between = 0;
  for (const auto& [a, b] : mesh_edges(rig->mesh.triangles, rig->mesh.vertex_count())) {
    if (!skin.count(a) || !skin.count(b)) continue;
    const float length = (rig->mesh.vertex(a) - rig->mesh.vertex(b)).norm();
    EXPECT_LT(std::abs(share(a) - share(b)), 0.05f + 45 * length);  // at most .45 in a centimetre
    between += share(a) > 0.05f && share(a) < 0.95f;
  }
  EXPECT_GT(between, 300);
}

TEST_F(IctData, ReadsTheOriginalObjFiles) {
  // A FaceXModel folder made of the same neutral mesh, with every shape moving one known vertex.
  const Path folder = Path(testing::TempDir()) / "effigy_ict_obj" / "FaceXModel";
  std::filesystem::remove_all(folder.parent_path());
  std::filesystem::create_directories(folder);
  std::filesystem::copy_file(data_folder() / "generic_neutral_mesh.obj",
                             folder / "generic_neutral_mesh.obj");
  std::ifstream neutral(folder / "generic_neutral_mesh.obj");
  std::string line, moved;
  const int nose = 4857;  // landmark 30
  for (int v = 0; std::getline(neutral, line);) {
    if (line.rfind("v ", 0) != 0) continue;
    float x = 0, y = 0, z = 0;
    ASSERT_EQ(std::sscanf(line.c_str(), "v %f %f %f", &x, &y, &z), 3);
    if (v++ == nose) z += 2;
    moved += "v " + std::to_string(x) + " " + std::to_string(y) + " " + std::to_string(z) + "\n";
  }
  std::ofstream(folder / "jawOpen.obj") << moved;
  std::ofstream(folder / "identity000.obj") << moved;
  std::ofstream(folder / "identity001.obj") << moved;
  std::ifstream indices(data_folder() / "vertex_indices.json");
  const std::string json{std::istreambuf_iterator<char>(indices), {}};
  const size_t at = json.find("\"idx_to_landmark_verts\"");
  const std::string landmarks = json.substr(at, json.find(']', at) - at + 1);
  std::ofstream(folder / "vertex_indices.json")
      << "{\"expressions\": [\"jawOpen\"], " << landmarks << "}";
  const Rig small = load_ict(folder.parent_path(), {});
  EXPECT_EQ(small.expression_count, 1);
  EXPECT_EQ(small.identity_count, 2);
  EXPECT_GE(small.mediapipe.size(), 68u);  // without the canonical face: the corresponding points
  int changed = 0;
  for (size_t v = 0; v < small.expression_basis.size(); v += 3) {
    const Vec3f d(small.expression_basis.data() + v);
    if (d.norm() < 1e-5f) continue;
    ++changed;
    EXPECT_NEAR(d.z(), 0.02f, 1e-5f);
    EXPECT_LT(
        (small.mesh.vertex(static_cast<int>(v / 3)) - landmark(rig->mesh.vertices, 30)).norm(),
        1e-5f);
  }
  EXPECT_EQ(changed, 1);
  std::filesystem::remove_all(folder.parent_path());
}

TEST(Ict, NamesWhatIsMissing) {
  const Path folder = Path(testing::TempDir()) / "effigy_ict_broken";
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder);
  EXPECT_FALSE(is_ict_folder(folder));
  const auto message = [&] {
    try {
      load_ict(folder, {});
    } catch (const Error& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  EXPECT_NE(message().find("generic_neutral_mesh.obj"), std::string::npos);
  std::ofstream(folder / "generic_neutral_mesh.obj") << "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
  EXPECT_FALSE(is_ict_folder(folder));
  EXPECT_NE(message().find("26719"), std::string::npos);
  std::ofstream(folder / "vertex_indices.json") << "{}";
  EXPECT_TRUE(is_ict_folder(folder));
  EXPECT_NE(message().find("26719"), std::string::npos);
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace effigy
