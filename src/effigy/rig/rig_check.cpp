#include <cmath>

#include "effigy/base/error.h"
#include "effigy/rig/rig.h"

namespace effigy {
namespace {

constexpr int kMostJoints = 256;
constexpr int kMostShapes = 100'000;
constexpr int kMostVertices = 10'000'000;
constexpr float kFurthestUv = 1000;  // tiles; far beyond, texels cannot be counted in 32 bits

class Checker {
 public:
  Checker(const Rig& rig, const std::string& name)
      : rig_(rig), name_(name), v3_(rig.mesh.vertices.size()) {}

  void check() const {
    check_mesh(rig_.mesh, name_);
    need(rig_.mesh.vertex_count() <= kMostVertices, "mesh", "has more than ten million vertices");
    check_uvs();
    check_counts();
    check_bases();
    check_joints();
    check_weights();
    check_landmarks(rig_.mediapipe, "mediapipe", 478);
    check_landmarks(rig_.multipie, "multipie", 68);
    for (const int vertex : rig_.neck_ring)
      need(vertex >= 0 && vertex < rig_.mesh.vertex_count(), "neck_ring",
           "names vertex " + std::to_string(vertex) + ", which does not exist");
  }

 private:
  void need(bool condition, const char* field, const std::string& what) const {
    if (!condition)
      throw Error(name_ + ": rig field '" + field + "' " + what + "; make the rig again.");
  }
  void need_size(size_t size, size_t expected, const char* field) const {
    if (size != expected)
      need(false, field,
           "has " + std::to_string(size) + " entries where " + std::to_string(expected) +
               " are expected");
  }
  void need_finite(const std::vector<float>& values, const char* field) const {
    for (size_t i = 0; i < values.size(); ++i)
      if (!std::isfinite(values[i]))
        need(false, field, "is not finite at element " + std::to_string(i));
  }

  // check_mesh has seen indices and values. Every avatar has its look in textures.
  void check_uvs() const {
    if (rig_.mesh.uv_triangles.empty())
      throw Error(
          name_ +
          ": the rig's mesh has no texture coordinates (UVs), and an avatar's textures need "
          "them; unwrap the mesh and make the rig again.");
    for (size_t i = 0; i < rig_.mesh.uvs.size(); ++i)
      if (rig_.mesh.uvs[i].cwiseAbs().maxCoeff() > kFurthestUv)
        need(false, "uvs", "is nowhere near [0, 1] at UV vertex " + std::to_string(i));
  }

  void check_counts() const {
    need(rig_.identity_count >= 0 && rig_.identity_count <= kMostShapes, "identity_count",
         "is impossible");
    need(rig_.expression_count >= 0 && rig_.expression_count <= kMostShapes, "expression_count",
         "is impossible");
    need(!rig_.parents.empty() && rig_.joint_count() <= kMostJoints, "parents",
         "needs between 1 and 256 joints");
    const size_t expressions = static_cast<size_t>(rig_.expression_count);
    need_size(rig_.expression_names.size(), expressions, "expression_names");
    need_size(rig_.identity_sigma.size(), static_cast<size_t>(rig_.identity_count),
              "identity_sigma");
    need_size(rig_.expression_low.size(), expressions, "expression_low");
    need_size(rig_.expression_high.size(), expressions, "expression_high");
    need_finite(rig_.identity_sigma, "identity_sigma");
    need_finite(rig_.expression_low, "expression_low");
    need_finite(rig_.expression_high, "expression_high");
    for (const float sigma : rig_.identity_sigma)
      need(sigma >= 0, "identity_sigma", "has a negative entry");
    for (size_t k = 0; k < expressions; ++k)
      need(rig_.expression_low[k] <= rig_.expression_high[k], "expression_low",
           "is above expression_high for '" + rig_.expression_names[k] + "'");
  }

  void check_bases() const {
    need_size(rig_.identity_basis.size(), static_cast<size_t>(rig_.identity_count) * v3_,
              "identity_basis");
    need_size(rig_.expression_basis.size(), static_cast<size_t>(rig_.expression_count) * v3_,
              "expression_basis");
    if (!rig_.pose_basis.empty())
      need_size(rig_.pose_basis.size(), 9 * (rig_.parents.size() - 1) * v3_, "pose_basis");
    need_finite(rig_.identity_basis, "identity_basis");
    need_finite(rig_.expression_basis, "expression_basis");
    need_finite(rig_.pose_basis, "pose_basis");
  }

  void check_joints() const {
    need_size(rig_.joint_names.size(), rig_.parents.size(), "joint_names");
    for (int j = 0; j < rig_.joint_count(); ++j) {
      const int parent = rig_.parents[static_cast<size_t>(j)];
      need(j == 0 ? parent == -1 : parent >= 0 && parent < j, "parents",
           "gives joint " + std::to_string(j) + " the parent " + std::to_string(parent));
    }
    need_size(rig_.joint_regressor.size(), rig_.parents.size() * v3_ / 3, "joint_regressor");
    need_finite(rig_.joint_regressor, "joint_regressor");
  }

  void check_weights() const {
    const size_t joints = rig_.parents.size();
    need_size(rig_.weights.size(), joints * v3_ / 3, "weights");
    need_finite(rig_.weights, "weights");
    for (size_t v = 0; v < v3_ / 3; ++v) {
      double sum = 0;
      for (size_t j = 0; j < joints; ++j) {
        const float weight = rig_.weights[v * joints + j];
        if (weight < -1e-3f)
          need(false, "weights", "has a negative weight at vertex " + std::to_string(v));
        sum += static_cast<double>(weight);
      }
      if (std::abs(sum - 1) > 1e-3)
        need(false, "weights",
             "sums to " + std::to_string(sum) + " instead of 1 at vertex " + std::to_string(v));
    }
  }

  void check_landmarks(const LandmarkEmbedding& embedding, const char* field, int points) const {
    need_size(embedding.triangle.size(), embedding.index.size(), field);
    need_size(embedding.barycentric.size(), embedding.index.size(), field);
    for (size_t i = 0; i < embedding.size(); ++i) {
      const int index = embedding.index[i], triangle = embedding.triangle[i];
      if (index < 0 || index >= points)
        need(false, field, "has the point number " + std::to_string(index));
      if (triangle < 0 || triangle >= rig_.mesh.triangle_count())
        need(false, field, "names triangle " + std::to_string(triangle) + ", which does not exist");
      const Vec3f& b = embedding.barycentric[i];
      if (!b.allFinite() || b.cwiseAbs().maxCoeff() > 10 || std::abs(b.sum() - 1) > 1e-2f)
        need(false, field,
             "has barycentric weights that do not sum to 1 at entry " + std::to_string(i));
    }
  }

  const Rig& rig_;
  const std::string& name_;
  size_t v3_;
};

}  // namespace

void check_rig(const Rig& rig, const std::string& name) {
  Checker(rig, name).check();
}

}  // namespace effigy
