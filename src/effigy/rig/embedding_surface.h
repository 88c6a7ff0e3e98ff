// Closest points and lines on a rig's template, for landmark embedding and surface fitting.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "effigy/rig/rig.h"

namespace effigy::embedding {

struct SurfacePoint {
  int triangle = -1;  // of the rig's mesh; -1: none
  Vec3d barycentric = Vec3d::Zero();
  Vec3d position = Vec3d::Zero();
};

// The triangles of one part of the mesh, for closest-point and ray queries (brute force with
// bounding spheres; a few thousand triangles, a few thousand queries).
class Surface {
 public:
  // All triangles when the mesh has no part of that name.
  Surface(const Mesh& mesh, const std::string& part);
  bool empty() const { return triangles_.empty(); }

  // Closest point whose triangle's normal is within acos(least_cosine) of `normal`.
  SurfacePoint closest(const Vec3d& point, const Vec3d& normal, double least_cosine) const;
  // The last crossing of the ray origin + s * direction, s > 0.
  SurfacePoint last_hit(const Vec3d& origin, const Vec3d& direction) const;
  // Mean position over the area.
  Vec3d centroid() const;

 private:
  struct Triangle {
    int index;
    Vec3d a, b, c, normal, center;
    double radius;
  };
  std::vector<Triangle> triangles_;
};

// For each vertex of one part (of the whole mesh when there is no such part) its neighbours, each
// with the triangles that hold the edge.
using EdgeGraph = std::map<int, std::map<int, std::vector<int>>>;
EdgeGraph edge_graph(const Mesh& mesh, const std::string& part);

// The vertices of a walk along edges through `stops`, in order, between each two the shortest way
// that stays near the Catmull-Rom spline through all of them. Stops that are not connected follow
// each other directly.
std::vector<int> walk_through(const Mesh& mesh, const EdgeGraph& graph,
                              const std::vector<int>& stops);

// A line on the surface through the given landmarks of rig.multipie, in order.
class SurfaceLine {
 public:
  enum class Course {
    kEdges,   // along mesh edges (walk_through): for rims that are edge loops of the mesh
    kSmooth,  // below the Catmull-Rom spline, on the triangles next to that walk: for soft rims
  };
  SurfaceLine(const Rig& rig, const EdgeGraph& graph, const std::vector<int>& landmarks,
              Course course);
  // Length from the first landmark to the i-th.
  double length_at(size_t i) const { return stops_[i]; }
  // The point at this length from the first landmark, metres.
  SurfacePoint at(double length) const;

 private:
  // From one point to another; barycentric in the triangle on edges.
  struct Segment {
    int triangle;
    Vec3d from, to;
    double end;  // length of the line up to here
  };
  const Mesh& mesh_;
  Course course_;
  std::vector<Segment> segments_;
  std::vector<double> stops_;
  std::vector<int> near_;  // kSmooth: the triangles to look at
  SurfacePoint first_;
};

Vec3d position_on(const Mesh& mesh, int triangle, const Vec3d& barycentric);

}  // namespace effigy::embedding
