#include "effigy/rig/embedding.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <cstring>
#include <map>
#include <set>

#include "effigy/base/error.h"
#include "effigy/base/random.h"
#include "effigy/rig/embedding_surface.h"
#include "effigy/rig/ict.h"

namespace effigy {
namespace {

// --- the canonical face's file -------------------------------------------------------------------

void put_varint(std::vector<uint8_t>& out, uint64_t value) {
  for (; value >= 0x80; value >>= 7) out.push_back(static_cast<uint8_t>(value | 0x80));
  out.push_back(static_cast<uint8_t>(value));
}

void put_float(std::vector<uint8_t>& out, float value) {
  uint8_t raw[4];
  std::memcpy(raw, &value, 4);
  out.insert(out.end(), raw, raw + 4);
}

// A metadata message with `vertices` vertices and two triangles.
std::vector<uint8_t> metadata(int vertices, bool packed, uint64_t last_index = 467) {
  std::vector<uint8_t> mesh = {0x08, 0x00, 0x10, 0x00}, numbers;
  for (int i = 0; i < 5 * vertices; ++i) {
    if (!packed) mesh.push_back((3 << 3) | 5);
    put_float(packed ? numbers : mesh, 0.25f * static_cast<float>(i % 97) - 3);
  }
  if (packed) {
    mesh.push_back((3 << 3) | 2);
    put_varint(mesh, numbers.size());
    mesh.insert(mesh.end(), numbers.begin(), numbers.end());
  }
  for (const uint64_t i :
       {uint64_t{0}, uint64_t{1}, uint64_t{2}, uint64_t{200}, uint64_t{7}, last_index}) {
    mesh.push_back((4 << 3) | 0);
    put_varint(mesh, i);
  }
  std::vector<uint8_t> out = {0x0a};
  put_varint(out, mesh.size());
  out.insert(out.end(), mesh.begin(), mesh.end());
  return out;
}

TEST(CanonicalFace, IsReadAloneAndInsideAContainer) {
  for (const bool packed : {false, true}) {
    std::vector<uint8_t> bytes = metadata(468, packed);
    bytes.insert(bytes.end(), {0x12, 0x02, 0x08, 0x04});  // what follows in the real file
    for (const size_t before : {size_t{0}, size_t{1000}}) {
      std::vector<uint8_t> container(before, 0x0a);
      container.insert(container.end(), bytes.begin(), bytes.end());
      container.resize(container.size() + 500, 0x0a);
      const CanonicalFace face = parse_canonical_face(container);
      ASSERT_EQ(face.vertices.size(), 468u);
      ASSERT_EQ(face.triangles.size(), 2u);
      EXPECT_EQ(face.triangles[1], Vec3i(200, 7, 467));
      EXPECT_FLOAT_EQ(face.vertices[1].x(), 0.01f * (0.25f * 5 - 3));  // centimetres in the file
      EXPECT_FLOAT_EQ(face.uvs[1].x(), 0.25f * 8 - 3);
    }
  }
}

TEST(CanonicalFace, DamagedFilesHaveNone) {
  EXPECT_TRUE(parse_canonical_face({}).empty());
  EXPECT_TRUE(parse_canonical_face(metadata(467, false)).empty());
  EXPECT_TRUE(parse_canonical_face(metadata(469, true)).empty());
  EXPECT_TRUE(parse_canonical_face(metadata(468, false, 468)).empty());
  const std::vector<uint8_t> good = metadata(468, false);
  for (size_t cut = 0; cut < good.size(); cut += 101)
    EXPECT_TRUE(parse_canonical_face(std::span(good).first(cut)).empty());
  std::vector<uint8_t> nan = good;
  for (size_t i = 12; i < 16; ++i) nan[i - 4] = 0xff;
  EXPECT_TRUE(parse_canonical_face(nan).empty());
  // Any single wrong byte gives a face or none, never a crash or a wild index.
  Random random(5);
  for (int k = 0; k < 200; ++k) {
    std::vector<uint8_t> wrong = good;
    wrong[random.below(wrong.size())] = static_cast<uint8_t>(random.bits());
    const CanonicalFace face = parse_canonical_face(wrong);
    for (const Vec3i& f : face.triangles) EXPECT_LT(f.maxCoeff(), 468);
  }
}

TEST(CanonicalFace, NoModelsNoFace) {
  EXPECT_TRUE(find_canonical_face({}).empty());
  EXPECT_TRUE(find_canonical_face("/no/such/folder").empty());
}

// --- the surface ---------------------------------------------------------------------------------

// A wavy sheet of n x n squares, 0.1 m wide, facing +z.
Mesh sheet(int n) {
  Mesh mesh;
  mesh.parts = {"skin"};
  for (int j = 0; j <= n; ++j)
    for (int i = 0; i <= n; ++i) {
      const float x = 0.1f * static_cast<float>(i) / static_cast<float>(n);
      const float y = 0.1f * static_cast<float>(j) / static_cast<float>(n);
      for (const float c : {x, y, 0.01f * std::sin(60 * x) * std::cos(40 * y)})
        mesh.vertices.push_back(c);
    }
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) {
      const int a = j * (n + 1) + i;
      mesh.triangles.emplace_back(a, a + 1, a + n + 2);
      mesh.triangles.emplace_back(a, a + n + 2, a + n + 1);
    }
  mesh.triangle_part.assign(mesh.triangles.size(), 0);
  return mesh;
}

TEST(EmbeddingSurface, ClosestPointsAreClosest) {
  const Mesh mesh = sheet(10);
  const embedding::Surface surface(mesh, "skin");
  Random random(3);
  for (int k = 0; k < 100; ++k) {
    const Vec3d p(random.uniform(-0.03, 0.13), random.uniform(-0.03, 0.13),
                  random.uniform(-0.05, 0.05));
    const embedding::SurfacePoint hit = surface.closest(p, Vec3d::UnitZ(), -1);
    ASSERT_GE(hit.triangle, 0);
    EXPECT_NEAR(hit.barycentric.sum(), 1, 1e-12);
    EXPECT_GE(hit.barycentric.minCoeff(), -1e-12);
    EXPECT_NEAR((embedding::position_on(mesh, hit.triangle, hit.barycentric) - hit.position).norm(),
                0, 1e-12);
    double sampled = 1;  // no sample of the surface is closer
    for (const Vec3i& f : mesh.triangles)
      for (int i = 0; i <= 8; ++i)
        for (int j = 0; i + j <= 8; ++j) {
          const double a = i / 8.0, b = j / 8.0;
          const Vec3d q = (1 - a - b) * mesh.vertex(f[0]).cast<double>() +
                          a * mesh.vertex(f[1]).cast<double>() +
                          b * mesh.vertex(f[2]).cast<double>();
          sampled = std::min(sampled, (q - p).norm());
        }
    EXPECT_LE((hit.position - p).norm(), sampled + 1e-12);
    EXPECT_GT((hit.position - p).norm(), sampled - 2e-3);
  }
  EXPECT_LT(surface.closest(Vec3d::Zero(), -Vec3d::UnitZ(), 0.5).triangle, 0);  // wrong side
}

TEST(EmbeddingSurface, RaysHitTheLastTriangle) {
  const Mesh mesh = sheet(6);
  const embedding::Surface surface(mesh, "skin");
  const embedding::SurfacePoint hit = surface.last_hit(Vec3d(0.043, 0.057, -1), Vec3d::UnitZ());
  ASSERT_GE(hit.triangle, 0);
  EXPECT_NEAR(hit.position.x(), 0.043, 1e-9);
  EXPECT_NEAR((embedding::position_on(mesh, hit.triangle, hit.barycentric) - hit.position).norm(),
              0, 1e-7);
  EXPECT_LT(surface.last_hit(Vec3d(0.043, 0.057, 1), Vec3d::UnitZ()).triangle, 0);
  EXPECT_LT(surface.last_hit(Vec3d(0.2, 0.057, -1), Vec3d::UnitZ()).triangle, 0);
}

Rig sheet_rig(int n) {
  Rig rig;
  rig.kind = "sheet";
  rig.mesh = sheet(n);
  for (int i = 0; i < 68; ++i) {  // in rows, off the vertices
    rig.multipie.index.push_back(i);
    rig.multipie.triangle.push_back((i * 2) % rig.mesh.triangle_count());
    rig.multipie.barycentric.emplace_back(0.5f, 0.3f, 0.2f);
  }
  return rig;
}

TEST(EmbeddingSurface, LinesPassThroughTheirLandmarks) {
  const Rig rig = sheet_rig(12);
  const embedding::EdgeGraph graph = embedding::edge_graph(rig.mesh, "skin");
  const std::vector<float> landmarks =
      landmark_positions(rig.multipie, rig.mesh.triangles, rig.mesh.vertices);
  const std::vector<int> stops = {0, 4, 8, 11};
  for (const auto course :
       {embedding::SurfaceLine::Course::kEdges, embedding::SurfaceLine::Course::kSmooth}) {
    const embedding::SurfaceLine line(rig, graph, stops, course);
    for (size_t i = 0; i < stops.size(); ++i) {
      const Vec3d expected =
          Vec3f(landmarks.data() + 3 * static_cast<size_t>(stops[i])).cast<double>();
      EXPECT_LT((line.at(line.length_at(i)).position - expected).norm(), 1e-6);
    }
    // And between them never far from the straight line, and without jumps.
    Vec3d last = line.at(0).position;
    for (int k = 1; k <= 200; ++k) {
      const Vec3d p = line.at(line.length_at(3) * k / 200).position;
      EXPECT_LT((p - last).norm(), 2.5e-3);
      EXPECT_NEAR(p.y(), last.y(), 4e-3);
      last = p;
    }
  }
}

TEST(Embedding, CorrespondingPointsAreThe68) {
  const Rig rig = sheet_rig(12);
  const LandmarkEmbedding points = embed_corresponding(rig);
  ASSERT_EQ(points.size(), 68u);  // no eyes, no irises
  EXPECT_EQ(points.triangle, rig.multipie.triangle);
  const auto& map = mediapipe_of_multipie();
  EXPECT_EQ(std::set<int>(map.begin(), map.end()).size(), 68u);
  EXPECT_EQ(points.index[30], 4);
}

TEST(Embedding, NeedsAllLandmarksAndAFace) {
  Rig rig = sheet_rig(12);
  EXPECT_THROW(embed_canonical(rig, {}), Error);
  rig.multipie.index[5] = 6;
  EXPECT_THROW(embed_corresponding(rig), Error);
}

// --- on ICT-FaceKit ------------------------------------------------------------------------------

class IctEmbedding : public testing::Test {
 protected:
  void SetUp() override {
    const char* data = std::getenv("EFFIGY_DATA");
    if (!data || !is_ict_folder(Path(data) / "face" / "ict_facekit") ||
        find_canonical_face(Path(data) / "models").empty())
      GTEST_SKIP() << "ICT-FaceKit or the landmark network is not there; set EFFIGY_DATA to a "
                      "folder with face/ict_facekit and models to run this test.";
    static const Rig kRig = load_ict(Path(data) / "face" / "ict_facekit", Path(data) / "models");
    rig = &kRig;
    face = find_canonical_face(Path(data) / "models");
    for (size_t i = 0; i < rig->mediapipe.size(); ++i)
      place[rig->mediapipe.index[i]] = static_cast<int>(i);
    rest = landmark_positions(rig->mediapipe, rig->mesh.triangles, rig->mesh.vertices);
  }
  Vec3f point(const std::vector<float>& positions, int index) const {
    return Vec3f(positions.data() + 3 * static_cast<size_t>(place.at(index)));
  }
  std::vector<float> posed(const std::string& expression) const {
    RigPose pose = RigPose::rest(*rig);
    pose.expression[static_cast<size_t>(rig->expression(expression))] = 1;
    std::vector<float> vertices;
    pose_vertices(shape_rig(*rig, {}), pose, vertices);
    return landmark_positions(rig->mediapipe, rig->mesh.triangles, vertices);
  }

  const Rig* rig = nullptr;
  CanonicalFace face;
  std::map<int, int> place;  // entry of each point
  std::vector<float> rest;
};

TEST_F(IctEmbedding, HasAllPointsOnTheRightParts) {
  ASSERT_EQ(place.size(), 478u);
  for (size_t i = 0; i < rig->mediapipe.size(); ++i) {
    const int index = rig->mediapipe.index[i];
    const std::string& part = rig->mesh.parts[static_cast<size_t>(
        rig->mesh.triangle_part[static_cast<size_t>(rig->mediapipe.triangle[i])])];
    EXPECT_EQ(part, index < 468 ? "skin" : index < 473 ? "eye_right" : "eye_left") << index;
  }
  EXPECT_EQ(face.triangles.size(), 898u);
}

TEST_F(IctEmbedding, AgreesWithThe68) {
  const std::vector<float> landmarks =
      landmark_positions(rig->multipie, rig->mesh.triangles, rig->mesh.vertices);
  for (int i = 0; i < 68; ++i) {
    const Vec3f own(landmarks.data() + 3 * static_cast<size_t>(i));
    const float distance =
        (own - point(rest, mediapipe_of_multipie()[static_cast<size_t>(i)])).norm();
    // The two sets divide brows and lips a little differently; the jaw line has no fixed points.
    EXPECT_LT(distance, i < 17 ? 7e-3f : i < 27 ? 4.5e-3f : i < 48 ? 2.5e-3f : 3.5e-3f) << i;
  }
}

TEST_F(IctEmbedding, IsSymmetric) {
  double sum = 0;
  int pairs = 0;
  for (int i = 0; i < 468; ++i) {
    Vec3f mirrored = face.vertices[static_cast<size_t>(i)];
    mirrored.x() *= -1;
    int other = -1;
    for (int j = 0; j < 468; ++j)
      if ((face.vertices[static_cast<size_t>(j)] - mirrored).norm() < 1e-4f) other = j;
    if (other < 0) continue;
    Vec3f expected = point(rest, other);
    expected.x() *= -1;
    const double distance = static_cast<double>((point(rest, i) - expected).norm());
    EXPECT_LT(distance, 2e-3) << i << " and " << other;
    sum += distance;
    ++pairs;
  }
  EXPECT_GT(pairs, 400);
  EXPECT_LT(sum / pairs, 3e-4);
}

TEST_F(IctEmbedding, KeepsTheOrderOfTheCanonicalMesh) {
  // Hardly any triangle of the canonical mesh is turned over on the rig (the lips meet there).
  int turned = 0;
  for (const Vec3i& f : face.triangles) {
    const auto normal = [](const Vec3f& a, const Vec3f& b, const Vec3f& c) {
      return Vec3f((b - a).cross(c - a));
    };
    const Vec3f before =
        normal(face.vertices[static_cast<size_t>(f[0])], face.vertices[static_cast<size_t>(f[1])],
               face.vertices[static_cast<size_t>(f[2])]);
    const Vec3f after = normal(point(rest, f[0]), point(rest, f[1]), point(rest, f[2]));
    turned += before.dot(after) <= 0;
  }
  EXPECT_LE(turned, 25);
}

TEST_F(IctEmbedding, LipsAndLidsAreOnTheirOwnSide) {
  const std::vector<float> open = posed("jawOpen");
  for (const int i : {81, 82, 13, 312, 311, 37, 0, 267})  // upper lip
    EXPECT_LT((point(open, i) - point(rest, i)).norm(), 0.012f) << i;
  for (const int i : {178, 87, 14, 317, 402, 84, 17, 314})  // lower lip
    EXPECT_GT(point(rest, i).y() - point(open, i).y(), 0.018f) << i;
  const std::vector<float> shut = posed("eyeBlink_L");
  for (const int i : {385, 386, 387}) {  // left upper lid comes down
    EXPECT_GT(point(rest, i).y() - point(shut, i).y(), 3e-3f) << i;
  }
  for (const int i : {380, 374, 373})  // left lower lid hardly moves
    EXPECT_LT((point(rest, i) - point(shut, i)).norm(), 3e-3f) << i;
  for (const auto& [upper, lower] : {std::pair{386, 374}, {385, 380}, {387, 373}}) {
    EXPECT_GT((point(rest, upper) - point(rest, lower)).norm(), 6e-3f);
    EXPECT_LT((point(shut, upper) - point(shut, lower)).norm(), 2.5e-3f);
  }
}

TEST_F(IctEmbedding, IrisesAreOnTheEyeballs) {
  for (const auto& [first, sign] : {std::pair{468, -1.f}, {473, 1.f}}) {
    const Vec3f center = point(rest, first);
    EXPECT_NEAR(center.x(), sign * 0.031f, 2e-3f);
    for (int k = 1; k <= 4; ++k) {
      Vec3f d = point(rest, first + k) - center;
      EXPECT_LT(d.z(), 0);
      d.z() = 0;
      EXPECT_NEAR(d.norm(), 5.85e-3f, 2e-4f);
    }
    EXPECT_GT(point(rest, first + 1).x(), center.x() + 5e-3f);  // towards the subject's left
    EXPECT_GT(point(rest, first + 2).y(), center.y() + 5e-3f);
    EXPECT_LT(point(rest, first + 3).x(), center.x() - 5e-3f);
    EXPECT_LT(point(rest, first + 4).y(), center.y() - 5e-3f);
  }
}

}  // namespace
}  // namespace effigy
