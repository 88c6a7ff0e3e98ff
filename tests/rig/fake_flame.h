// Files with the structure of FLAME's, made by code: same counts, names and types, other contents.
#pragma once

#include <array>
#include <cmath>
#include <map>
#include <string>
#include <vector>

#include "base/pickle_writer.h"
#include "effigy/base/file.h"
#include "effigy/geometry/mesh.h"

namespace effigy::test {

// A surface with FLAME's numbers of vertices and triangles: a tube from a neck rim (30 vertices) to
// a lip rim (32), and two spheres.
class FakeHead {
 public:
  FakeHead() {
    constexpr int kNeck = 30, kLips = 32, kRings = 129;
    for (int ring = 0; ring < kRings; ++ring) add_ring(kNeck, static_cast<float>(ring) / kRings);
    add_ring(kLips, 1);
    for (int ring = 0; ring + 1 < kRings; ++ring) join(ring * kNeck, kNeck, kNeck);
    join((kRings - 1) * kNeck, kNeck, kLips);
    // A vertex in the middle of each of the first 29 triangles.
    for (size_t f = 0; f < 29; ++f) {
      const Vec3i t = mesh.triangles[f];
      const int middle = mesh.vertex_count();
      add_vertex((mesh.vertex(t[0]) + mesh.vertex(t[1]) + mesh.vertex(t[2])) / 3,
                 Vec2f(0.05f, 0.05f));
      mesh.triangles[f] = Vec3i(t[0], t[1], middle);
      mesh.triangles.emplace_back(t[1], t[2], middle);
      mesh.triangles.emplace_back(t[2], t[0], middle);
    }
    for (const float side : {-1.0f, 1.0f}) add_eye(Vec3f(side * 0.032f, 0.03f, 0.05f));
    mesh.uv_triangles = mesh.triangles;
  }

  Mesh mesh;

 private:
  void add_vertex(const Vec3f& p, const Vec2f& uv) {
    for (int axis = 0; axis < 3; ++axis) mesh.vertices.push_back(p[axis]);
    mesh.uvs.push_back(uv);
  }
  // s = 0: the neck's rim, a circle below; s = 1: the lips' rim, an ellipse in front.
  void add_ring(int count, float s) {
    for (int i = 0; i < count; ++i) {
      const float angle =
          2 * static_cast<float>(M_PI) * static_cast<float>(i) / static_cast<float>(count);
      const float c = std::cos(angle), d = std::sin(angle);
      const Vec3f neck(0.06f * c, -0.14f, -0.06f * d - 0.03f);
      const Vec3f lips(0.026f * c, 0.0095f * d - 0.02f, 0.058f - 0.009f * c * c);
      const float bulge = std::sin(static_cast<float>(M_PI) * s);
      add_vertex((1 - s) * neck + s * lips + bulge * Vec3f(0.05f * c, 0.09f + 0.05f * d, -0.03f),
                 Vec2f(0.05f + 0.8f * static_cast<float>(i) / static_cast<float>(count),
                       0.05f + 0.88f * s));
    }
  }
  // Triangles between a ring of n vertices and the next one, of m.
  void join(int first, int n, int m) {
    for (int i = 0, j = 0; i < n || j < m;) {
      const int a = first + i % n, b = first + n + j % m;
      if (j == m || (i < n && i * m <= j * n)) {
        mesh.triangles.emplace_back(a, first + ++i % n, b);
      } else {
        mesh.triangles.emplace_back(a, first + n + ++j % m, b);
      }
    }
  }
  void add_eye(const Vec3f& center) {
    constexpr int kAround = 32, kRings = 17;
    const int first = mesh.vertex_count();
    add_vertex(center + Vec3f(0, 0.012f, 0), Vec2f(0.9f, 0.9f));
    for (int ring = 0; ring < kRings; ++ring)
      for (int i = 0; i < kAround; ++i) {
        const float down = static_cast<float>(M_PI) * static_cast<float>(ring + 1) / (kRings + 1);
        const float angle = 2 * static_cast<float>(M_PI) * static_cast<float>(i) / kAround;
        add_vertex(center + 0.012f * Vec3f(std::sin(down) * std::sin(angle), std::cos(down),
                                           std::sin(down) * std::cos(angle)),
                   Vec2f(0.88f + 0.001f * static_cast<float>(i),
                         0.9f - 0.005f * static_cast<float>(ring)));
      }
    add_vertex(center - Vec3f(0, 0.012f, 0), Vec2f(0.9f, 0.8f));
    const int last = mesh.vertex_count() - 1;
    for (int i = 0; i < kAround; ++i) {
      const int next = (i + 1) % kAround, bottom = first + 1 + (kRings - 1) * kAround;
      mesh.triangles.emplace_back(first, first + 1 + i, first + 1 + next);
      mesh.triangles.emplace_back(last, bottom + next, bottom + i);
      for (int ring = 0; ring + 1 < kRings; ++ring) {
        const int row = first + 1 + ring * kAround;
        mesh.triangles.emplace_back(row + i, row + kAround + i, row + next);
        mesh.triangles.emplace_back(row + next, row + kAround + i, row + kAround + next);
      }
    }
  }
};

// The arrays of a model, in double as FLAME has them; tests change them before writing.
struct FakeFlame {
  Mesh mesh;
  std::vector<double> v_template, shapedirs, posedirs, weights;
  std::vector<uint32_t> faces;
  std::vector<int64_t> parents = {4294967295, 0, 1, 1, 1, 0, 1, 2, 3, 4};
  std::vector<double> regressor;  // of the sparse matrix
  std::vector<int32_t> regressor_rows, regressor_starts;
  int64_t vertex_count = 5023;
  std::string left_out;  // a key that is not written

  // A light one has no shapes (small integers, all 0, in the file), which is much faster.
  explicit FakeFlame(const Mesh& head, bool light = false) : mesh(head) {
    const size_t v = 5023;
    v_template.assign(mesh.vertices.begin(), mesh.vertices.end());
    for (const Vec3i& t : mesh.triangles)
      for (int corner = 0; corner < 3; ++corner) faces.push_back(static_cast<uint32_t>(t[corner]));
    shapedirs.resize(light ? 0 : v * 3 * 400);
    posedirs.resize(light ? 0 : v * 3 * 36);
    for (double& value : shapedirs) value = 0.002 * next();
    for (double& value : posedirs) value = 0.002 * next();
    // The first identity direction moves everything alike.
    for (size_t i = 0; 400 * i < shapedirs.size(); ++i)
      shapedirs[400 * i] = 0.001 * static_cast<double>(1 + i % 3);
    for (size_t i = 0; i < v; ++i) {
      std::array<double, 5> row{};
      double sum = 0;
      for (double& w : row) sum += w = std::max(0.0, next());
      for (double& w : row) weights.push_back(sum > 0 ? w / sum : 0.2);
    }
    // Each column names one joint; the eyes are averages over their spheres.
    std::array<double, 5> count{};
    std::vector<int> joint(v);
    for (size_t i = 0; i < v; ++i) {
      joint[i] = i < 3931 ? static_cast<int>(i % 3) : eye_of(i);
      ++count[static_cast<size_t>(joint[i])];
    }
    for (size_t i = 0; i < v; ++i) {
      regressor_starts.push_back(static_cast<int32_t>(i));
      regressor_rows.push_back(joint[i]);
      regressor.push_back(1 / count[static_cast<size_t>(joint[i])]);
    }
    regressor_starts.push_back(static_cast<int32_t>(v));
  }

  // Joint 3 is the left eye (+x), as in FLAME.
  int eye_of(size_t vertex) const { return mesh.vertices[3 * vertex] > 0 ? 3 : 4; }

  void write(const Path& path, bool modern) const {
    PickleWriter w(modern);
    std::vector<std::pair<std::string, std::function<void()>>> entries = {
        {"f",
         [&] {
           w.array("<u4", {static_cast<int64_t>(faces.size() / 3), 3}, faces);
         }},
        {"bs_style", [&] { w.text("lbs"); }},
        {"v_template",
         [&] {
           w.array("<f8", {vertex_count, 3}, v_template);
         }},
        {"kintree_table",
         [&] {
           w.array("<i8", {2, 5}, parents);
         }},
        {"J_regressor", [&] { w.csc(5, 5023, regressor, regressor_rows, regressor_starts); }},
        {"weights",
         [&] {
           w.array("<f8", {5023, 5}, weights);
         }},
        {"posedirs", [&] { write_shapes(w, posedirs, 36, true); }},
        {"shapedirs", [&] { write_shapes(w, shapedirs, 400, modern); }}};
    std::erase_if(entries, [&](const auto& entry) { return entry.first == left_out; });
    w.dictionary(entries);
    write_file(path, w.finish());
  }

 private:
  static void write_shapes(PickleWriter& w, const std::vector<double>& values, int64_t count,
                           bool plain) {
    if (values.empty())
      w.array("|i1", {5023, 3, count}, std::vector<int8_t>(15069 * static_cast<size_t>(count)));
    else if (plain)
      w.array("<f8", {5023, 3, count}, values);
    else
      w.chumpy({5023, 3, count}, values);
  }
  double next() {  // -1 .. 1
    state_ = state_ * 6364136223846793005u + 1442695040888963407u;
    return static_cast<double>(state_ >> 40) / (1 << 23) - 1;
  }
  uint64_t state_ = 1;
};

inline std::vector<uint8_t> npy_bytes(const std::string& descr, const std::string& shape,
                                      const void* memory, size_t size) {
  const std::string header =
      "{'descr': '" + descr + "', 'fortran_order': False, 'shape': " + shape + ", }\n";
  std::string bytes("\x93NUMPY\1\0", 8);
  bytes += static_cast<char>(header.size());
  bytes += '\0';
  bytes += header;
  bytes.append(static_cast<const char*>(memory), size);
  return {bytes.begin(), bytes.end()};
}

}  // namespace effigy::test
