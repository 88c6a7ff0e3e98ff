// What the path tracer sees: triangle meshes with textured materials, an environment, point lights.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "effigy/capture/stage_capture.h"
#include "effigy/geometry/mesh.h"
#include "effigy/image/image.h"
#include "effigy/light/environment_sampler.h"
#include "effigy/rays/ray_scene.h"
#include "effigy/splat/surfel_raster.h"

namespace effigy {

// Textures of one material; an image of 1 x 1 pixels is a constant. Row 0 is v = 1. Sizes may
// differ from map to map.
struct SurfaceMaterial {
  Image albedo;     // 3, linear
  Image roughness;  // 1
  Image specular;   // 1, F0
  Image normal;     // 3, tangent space, OpenGL, not encoded; empty: flat
  Image opacity;    // 1; empty: opaque
  Image scatter;    // 1, times scatter_radius; empty: 1
  // Metres: d of the diffusion profile of each channel (subsurface.h), by which diffuse light
  // leaves elsewhere than it entered. Zero: Lambert.
  Vec3f scatter_radius = Vec3f::Zero();
  bool specular_lobe = true;
};
SurfaceMaterial constant_material(const Vec3f& albedo, float roughness, float specular);

// Where a ray meets a surface, and what is there. Normals face the ray's origin.
struct ScenePoint {
  Vec3f position;
  Vec3f origin;     // for rays that leave: off the facets, on the smooth surface they stand for
  Vec3f geometric;  // of the facet
  Vec3f normal;     // interpolated
  Vec3f mapped;     // with the normal map
  Vec2f uv;
  Vec3f albedo;
  float roughness, specular;  // specular < 0: no specular lobe
  Vec3f scatter;              // metres, 0: Lambert; also 0 where the ray met the back
  int mesh, part;             // part: of Mesh::triangle_part, 0 without
};

// Built once, posed for every frame. Queries are safe from many threads after commit().
class TraceScene {
 public:
  // Returns its number. Throws Error (prefixed by `name`) for empty or wrongly sized textures,
  // values that are not finite, albedo, roughness, F0 or opacity outside [0, 1].
  int add_material(const SurfaceMaterial& material, const std::string& name);
  // Returns its number. Throws Error for broken meshes and for a textured material on a mesh
  // without UVs. Positions are the mesh's own until pose().
  int add_mesh(const Mesh& mesh, int material, const std::string& name);
  // Positions of a mesh (3V). Throws Error when one is not finite.
  void pose(int mesh, std::span<const float> vertices);

  void set_environment(std::shared_ptr<const EnvironmentSampler> light) {
    environment_ = std::move(light);
  }
  // Throws Error for values that are not finite or negative.
  void set_point_lights(std::vector<StageLight> lights);
  const EnvironmentSampler* environment() const { return environment_.get(); }
  const std::vector<StageLight>& point_lights() const { return point_lights_; }

  // Per pixel, row by row: 0 where no ray through the pixel's square meets anything.
  std::vector<char> seen_pixels(const Camera& camera) const;

  // Indexes the posed meshes for rays. Throws Error when there is nothing to see.
  void commit();
  // Throws Error unless some light shines.
  void check_lights() const;
  // Throws Error when the point looks at the backs of surfaces in most directions.
  void check_outside(const Vec3d& eye) const;

  struct Hit {
    int triangle = -1;  // over all meshes
    float distance = 0, b = 0, c = 0;
  };
  Hit closest(const Vec3f& origin, const Vec3f& direction, float near = 0.0f) const;
  // Opacity at a hit, 1 for opaque materials.
  float opacity(const Hit& hit) const;
  ScenePoint surface(const Hit& hit, const Vec3f& direction) const;
  // Of the facet as its corners turn, whichever side was hit.
  Vec3f outward(const Hit& hit) const;
  // The share of light that passes between two points: 0 or 1 where everything is opaque.
  float transmittance(const Vec3f& origin, const Vec3f& direction, float far) const;
  // Smooth vertex normals of a posed mesh, 3V.
  const std::vector<float>& normals(int mesh) const { return meshes_.at(mesh).normals; }
  const std::vector<float>& vertices(int mesh) const { return meshes_.at(mesh).vertices; }
  int mesh_count() const { return static_cast<int>(meshes_.size()); }
  // Rays start this far off a surface.
  float offset() const { return offset_; }

 private:
  struct Material {
    MaterialTexture texture;  // spare channel: opacity
    bool transparent = false, specular_lobe = true, textured = false;
    Image scatter;
    Vec3f scatter_radius = Vec3f::Zero();
  };
  struct PosedMesh {
    Mesh mesh;
    std::vector<float> vertices, normals;
    int material = 0, first_triangle = 0;
    std::string name;
  };
  // All that shading a triangle needs, in two cache lines.
  struct alignas(64) Facet {
    Vec3f position[3], normal[3];
    Vec2f uv[3];
    Vec3f tangent;
    float handedness;
    int mesh, part;
  };
  void add_facets(const PosedMesh& mesh, int index);

  std::vector<Material> materials_;
  std::vector<PosedMesh> meshes_;
  std::shared_ptr<const EnvironmentSampler> environment_;
  std::vector<StageLight> point_lights_;
  std::vector<Facet> triangles_;
  std::unique_ptr<RayScene> rays_;
  bool transparent_ = false;
  float offset_ = 1e-5f;
};

}  // namespace effigy
