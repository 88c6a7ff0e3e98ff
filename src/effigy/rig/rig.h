// Rigs: deformable head templates. One data type serves the built-in head, ICT-FaceKit and FLAME:
//   rest(beta)   = template + identity_basis . beta
//   shaped       = rest + expression_basis . psi + pose_basis . vec(R_j - I)_{j >= 1}
//   vertices     = LBS(shaped, joints, weights, joint rotations) + translation
// (FLAME, Li et al. 2017; ICT has no pose basis.) Metres, y up, face +z.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "effigy/geometry/mesh.h"

namespace effigy {

// Points of a landmark network on the surface. index[i] is the network's point number.
struct LandmarkEmbedding {
  std::vector<int> index;
  std::vector<int> triangle;
  std::vector<Vec3f> barycentric;  // weights of the triangle's three vertices
  size_t size() const { return index.size(); }
};

struct Rig {
  std::string kind;     // "builtin", "ict-facekit", "flame-2020", "flame-2023", "flame-2023-open"
  std::string licence;  // e.g. "MIT", "CC-BY-4.0", "MPI non-commercial"
  Mesh mesh;            // template positions, topology, UV atlas, parts (see below)
  // parts (mesh.parts) use these names where they exist: "skin", "eye_left", "eye_right", "teeth",
  // "mouth" (gums, tongue, bag), "hair".

  int identity_count = 0, expression_count = 0;
  std::vector<float> identity_basis;    // [identity_count][V][3], metres per unit
  std::vector<float> expression_basis;  // [expression_count][V][3], metres per unit
  std::vector<std::string> expression_names;
  std::vector<float> identity_sigma;  // prior standard deviation of each coefficient
  std::vector<float> expression_low, expression_high;  // useful range of each coefficient
  std::vector<float> pose_basis;                       // [9 (J - 1)][V][3] or empty

  // Joints: 0 root, 1 neck, then by name; parents[0] = -1 and parents[j] < j.
  std::vector<std::string> joint_names;  // "root" "neck" ["jaw"] "eye_left" "eye_right"
  std::vector<int> parents;
  std::vector<float> joint_regressor;  // [J][V]: joint positions from rest vertices
  std::vector<float> weights;          // [V][J], rows sum to 1

  LandmarkEmbedding mediapipe;  // 468 or 478 points
  LandmarkEmbedding multipie;   // 68 points (MultiPIE/iBUG order)
  std::vector<int> neck_ring;   // vertices on the boundary of the neck, in order (may be empty)

  int joint_count() const { return static_cast<int>(parents.size()); }
  int joint(const std::string& name) const;       // -1 when absent
  int expression(const std::string& name) const;  // -1 when absent
};

// Parameters of one frame.
struct RigPose {
  std::vector<float> expression;       // expression_count
  std::vector<float> joint_rotation;   // 3 J, axis-angle, radians; joint 0 turns the whole head
  std::array<float, 3> translation{};  // metres, world

  static RigPose rest(const Rig& rig);
};

// Throws Error (prefixed by `name`) unless sizes, UVs, indices, weights and values are consistent.
void check_rig(const Rig& rig, const std::string& name);

// What deforms: the arrays that training may tune, plus the joints frozen at the rest shape.
struct RigShape {
  std::vector<float> rest;              // 3V
  std::vector<float> expression_basis;  // as Rig
  std::vector<float> pose_basis;        // as Rig
  std::vector<float> weights;           // as Rig
  std::vector<float> joints;            // 3J, positions at rest
  std::vector<int> parents;
};
// identity may be shorter than identity_count (the rest is zero).
RigShape shape_rig(const Rig& rig, std::span<const float> identity);

// Moves a joint of the shape at `identity` by `shift` (metres): the smallest change of its row of
// the regressor that does so, the row's sum kept.
void shift_joint(Rig& rig, std::span<const float> identity, int joint, const Vec3d& shift);

// Posed vertices (3V) into `vertices`.
void pose_vertices(const RigShape& shape, const RigPose& pose, std::vector<float>& vertices);

// Adds to the non-empty arrays of `gradient` (the caller sizes those it wants, zeroed) the
// derivative of a loss whose derivative with respect to the posed vertices is `d_vertices` (3V).
struct RigGradient {
  std::vector<float> rest, expression_basis, pose_basis, weights;  // as RigShape, or empty
  std::vector<float> expression, joint_rotation;                   // as RigPose, or empty
  std::array<float, 3> translation{};                              // always
};
void pose_vertices_backward(const RigShape& shape, const RigPose& pose,
                            std::span<const float> d_vertices, RigGradient& gradient);

// World (head-root) transform of each joint: 3x4 row-major matrices that map rest space to posed
// space, translation included, [J][12].
std::vector<float> joint_transforms(const RigShape& shape, const RigPose& pose);

// The position of each landmark on the given posed vertices, 3 per landmark.
std::vector<float> landmark_positions(const LandmarkEmbedding& embedding,
                                      const std::vector<Vec3i>& triangles,
                                      std::span<const float> vertices);

}  // namespace effigy
