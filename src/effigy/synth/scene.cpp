#include "effigy/synth/scene.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/random.h"
#include "effigy/image/resample.h"

namespace effigy {
namespace {

constexpr size_t kTexel = 8;

void check_map(const Image& map, int channels, float low, float high, const std::string& what) {
  if (map.empty() || map.channels != channels)
    throw Error(what + " has " + std::to_string(map.channels) + " channels, it must have " +
                std::to_string(channels) + "; save it again.");
  for (const float value : map.data)
    if (!std::isfinite(value) || value < low || value > high)
      throw Error(what + " holds a value outside " + std::to_string(static_cast<int>(low)) +
                  " .. " + std::to_string(static_cast<int>(high)) + "; correct it.");
}

// Bilinear, clamped to the edge texels. `out`: 8 values.
void lookup(const MaterialTexture& texture, const Vec2f& uv, float* out) {
  const float x = std::clamp(uv.x() * static_cast<float>(texture.width) - 0.5f, 0.0f,
                             static_cast<float>(texture.width - 1));
  const float y = std::clamp(uv.y() * static_cast<float>(texture.height) - 0.5f, 0.0f,
                             static_cast<float>(texture.height - 1));
  const int x0 = std::min(static_cast<int>(x), std::max(texture.width - 2, 0));
  const int y0 = std::min(static_cast<int>(y), std::max(texture.height - 2, 0));
  const size_t right = texture.width > 1 ? kTexel : 0;
  const size_t up = texture.height > 1 ? kTexel * static_cast<size_t>(texture.width) : 0;
  const float fx = x - static_cast<float>(x0), fy = y - static_cast<float>(y0);
  const float* p = &texture.texels[(static_cast<size_t>(y0) * texture.width + x0) * kTexel];
  const float w00 = (1 - fx) * (1 - fy), w10 = fx * (1 - fy), w01 = (1 - fx) * fy, w11 = fx * fy;
  for (size_t k = 0; k < kTexel; ++k)
    out[k] = w00 * p[k] + w10 * p[right + k] + w01 * p[up + k] + w11 * p[up + right + k];
}

Vec3f unit_or(const Vec3f& v, const Vec3f& otherwise) {
  const float square = v.squaredNorm();
  return square > 1e-20f ? Vec3f(v / std::sqrt(square)) : otherwise;
}

}  // namespace

SurfaceMaterial constant_material(const Vec3f& albedo, float roughness, float specular) {
  SurfaceMaterial material;
  material.albedo = Image(1, 1, 3);
  std::copy_n(albedo.data(), 3, material.albedo.data.begin());
  material.roughness = Image(1, 1, 1, roughness);
  material.specular = Image(1, 1, 1, specular);
  return material;
}

int TraceScene::add_material(const SurfaceMaterial& source, const std::string& name) {
  check_map(source.albedo, 3, 0, 1, name + ": the albedo map");
  check_map(source.roughness, 1, 0, 1, name + ": the roughness map");
  check_map(source.specular, 1, 0, 1, name + ": the specular map");
  if (!source.normal.empty()) check_map(source.normal, 3, -1, 1, name + ": the normal map");
  if (!source.opacity.empty()) check_map(source.opacity, 1, 0, 1, name + ": the opacity map");
  if (!source.scatter.empty()) check_map(source.scatter, 1, 0, 1, name + ": the scatter map");
  if (!source.scatter_radius.allFinite() || source.scatter_radius.minCoeff() < 0 ||
      (source.scatter_radius.maxCoeff() > 0 && source.scatter_radius.minCoeff() == 0))
    throw Error(name +
                ": its scatter radius must be three positive lengths in metres, or zero; "
                "correct it.");
  int width = 1, height = 1;
  for (const Image* map :
       {&source.albedo, &source.roughness, &source.specular, &source.normal, &source.opacity}) {
    width = std::max(width, map->width);
    height = std::max(height, map->height);
  }
  Material material;
  material.specular_lobe = source.specular_lobe;
  material.scatter = source.scatter;
  material.scatter_radius = source.scatter_radius;
  material.textured = width > 1 || height > 1 || source.scatter.width > 1;
  material.texture = MaterialTexture(width, height);
  for (int row = 0; row < height; ++row)
    for (int x = 0; x < width; ++x) {
      float* texel =
          &material.texture.texels[(static_cast<size_t>(height - 1 - row) * width + x) * kTexel];
      const auto take = [&](const Image& map, float* out) {
        sample_bilinear(map, (x + 0.5) * map.width / width, (row + 0.5) * map.height / height, out);
      };
      take(source.albedo, texel);
      take(source.roughness, texel + 3);
      take(source.specular, texel + 4);
      float bump[3] = {0, 0, 1};
      if (!source.normal.empty()) take(source.normal, bump);
      const Vec3f n = unit_or(Vec3f(bump), Vec3f::UnitZ());
      texel[5] = n.x();
      texel[6] = n.y();
      texel[7] = 1;
      if (!source.opacity.empty()) take(source.opacity, texel + 7);
      material.transparent |= texel[7] < 1;
    }
  materials_.push_back(std::move(material));
  return static_cast<int>(materials_.size()) - 1;
}

int TraceScene::add_mesh(const Mesh& mesh, int material, const std::string& name) {
  EFFIGY_CHECK(material >= 0 && material < static_cast<int>(materials_.size()));
  check_mesh(mesh, name);
  if (mesh.uv_triangles.empty() && materials_[material].textured)
    throw Error(name +
                " has no texture coordinates (UVs), which its textured material needs; "
                "unwrap it or give it a plain colour.");
  meshes_.push_back({mesh, mesh.vertices, {}, material, 0, name});
  return mesh_count() - 1;
}

void TraceScene::pose(int mesh, std::span<const float> vertices) {
  PosedMesh& posed = meshes_.at(mesh);
  EFFIGY_CHECK_EQ(vertices.size(), posed.mesh.vertices.size());
  for (size_t i = 0; i < vertices.size(); ++i)
    if (!std::isfinite(vertices[i]))
      throw Error(posed.name + ": its pose puts vertex " + std::to_string(i / 3) +
                  " at a place that is not finite; correct the pose.");
  posed.vertices.assign(vertices.begin(), vertices.end());
}

void TraceScene::set_point_lights(std::vector<StageLight> lights) {
  for (size_t i = 0; i < lights.size(); ++i)
    if (!lights[i].position.allFinite() || !lights[i].intensity.allFinite() ||
        lights[i].intensity.minCoeff() < 0)
      throw Error("Point light " + std::to_string(i) +
                  ": its position or intensity is not finite, or negative; correct it.");
  point_lights_ = std::move(lights);
}

void TraceScene::add_facets(const PosedMesh& posed, int index) {
  const Mesh& mesh = posed.mesh;
  const auto at = [](const std::vector<float>& v, int i) {
    return Vec3f(&v[3 * static_cast<size_t>(i)]);
  };
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    Facet corner{};
    for (int k = 0; k < 3; ++k) {
      const int v = mesh.triangles[t][k];
      corner.position[k] = at(posed.vertices, v);
      corner.normal[k] = at(posed.normals, v);
      corner.uv[k] = mesh.uv_triangles.empty() ? Vec2f(0, 0) : mesh.uvs[mesh.uv_triangles[t][k]];
    }
    const Vec3f e1 = corner.position[1] - corner.position[0],
                e2 = corner.position[2] - corner.position[0];
    const Vec2f d1 = corner.uv[1] - corner.uv[0], d2 = corner.uv[2] - corner.uv[0];
    corner.handedness = d1.x() * d2.y() - d1.y() * d2.x() < 0 ? -1.0f : 1.0f;
    corner.tangent = unit_or(corner.handedness * (e1 * d2.y() - e2 * d1.y()), Vec3f::UnitX());
    corner.mesh = index;
    corner.part = mesh.triangle_part.empty() ? 0 : mesh.triangle_part[t];
    triangles_.push_back(corner);
  }
}

void TraceScene::commit() {
  triangles_.clear();
  transparent_ = false;
  std::vector<float> vertices;
  std::vector<Vec3i> triangles;
  float extent = 0;
  for (size_t m = 0; m < meshes_.size(); ++m) {
    PosedMesh& posed = meshes_[m];
    posed.normals = vertex_normals(posed.vertices, posed.mesh.triangles);
    posed.first_triangle = static_cast<int>(triangles.size());
    const int first = static_cast<int>(vertices.size() / 3);
    vertices.insert(vertices.end(), posed.vertices.begin(), posed.vertices.end());
    for (const Vec3i& t : posed.mesh.triangles) triangles.push_back(t + Vec3i::Constant(first));
    add_facets(posed, static_cast<int>(m));
    transparent_ |= materials_[posed.material].transparent;
  }
  if (triangles.empty()) throw Error("The scene has no mesh; add one.");
  for (const float x : vertices) extent = std::max(extent, std::abs(x));
  offset_ = 1e-5f * std::max(extent, 1e-3f);
  rays_ = std::make_unique<RayScene>(vertices, triangles);
}

void TraceScene::check_lights() const {
  bool lit = environment_ != nullptr && environment_->flux().maxCoeff() > 0;
  for (const StageLight& light : point_lights_) lit |= light.intensity.maxCoeff() > 0;
  if (!lit)
    throw Error(
        "The scene has no light: the environment is black or missing and no point light "
        "shines; give it a light.");
}

void TraceScene::check_outside(const Vec3d& eye) const {
  constexpr int kRays = 64;
  Random random(1);
  int backs = 0;
  for (int i = 0; i < kRays; ++i) {
    const Vec3f d =
        Vec3d(random.normal(), random.normal(), random.normal()).normalized().cast<float>();
    const Hit hit = closest(eye.cast<float>(), d);
    if (hit.triangle < 0) continue;
    const Facet& corner = triangles_[hit.triangle];
    const Vec3f n =
        (corner.position[1] - corner.position[0]).cross(corner.position[2] - corner.position[0]);
    backs += n.dot(d) > 0 ? 1 : 0;
  }
  if (2 * backs > kRays)
    throw Error(
        "The camera is inside a mesh: it would see nothing but the backs of surfaces; move "
        "it out.");
}

std::vector<char> TraceScene::seen_pixels(const Camera& camera) const {
  constexpr double kMargin = 0.5;  // pixels, for rounding
  const auto width = static_cast<size_t>(camera.width), height = static_cast<size_t>(camera.height);
  std::vector<char> seen(width * height, 0);
  const double nearest = 1e-3 * static_cast<double>(offset_);
  for (const Facet& facet : triangles_) {
    Vec2d low = Vec2d::Constant(1e30), high = -low;
    int before = 0;
    for (const Vec3f& corner : facet.position) {
      const Vec3d p = camera.to_camera(corner.cast<double>());
      if (p.z() <= nearest) continue;
      ++before;
      const Vec2d at(camera.fx * p.x() / p.z() + camera.cx, camera.fy * p.y() / p.z() + camera.cy);
      low = low.cwiseMin(at);
      high = high.cwiseMax(at);
    }
    if (before == 0) continue;
    if (before < 3) return std::vector<char>(seen.size(), 1);  // reaches beside the camera
    const auto pixel = [](double x, size_t count) {
      return static_cast<size_t>(std::clamp(x, 0.0, static_cast<double>(count)));
    };
    const size_t x0 = pixel(low.x() - kMargin, width), x1 = pixel(high.x() + kMargin + 1, width);
    const size_t y0 = pixel(low.y() - kMargin, height), y1 = pixel(high.y() + kMargin + 1, height);
    for (size_t y = y0; y < y1; ++y)
      std::fill(seen.begin() + static_cast<std::ptrdiff_t>(y * width + x0),
                seen.begin() + static_cast<std::ptrdiff_t>(y * width + x1), char{1});
  }
  return seen;
}

TraceScene::Hit TraceScene::closest(const Vec3f& origin, const Vec3f& direction, float near) const {
  const RayHit hit = rays_->closest(origin, direction, near);
  return {hit.triangle, hit.distance, hit.b, hit.c};
}

float TraceScene::opacity(const Hit& hit) const {
  if (!transparent_) return 1;
  const Facet& corner = triangles_[hit.triangle];
  const Material& material = materials_[meshes_[corner.mesh].material];
  if (!material.transparent) return 1;
  const Vec2f uv = (1 - hit.b - hit.c) * corner.uv[0] + hit.b * corner.uv[1] + hit.c * corner.uv[2];
  float texel[kTexel];
  lookup(material.texture, uv, texel);
  return texel[7];
}

Vec3f TraceScene::outward(const Hit& hit) const {
  const Facet& t = triangles_[hit.triangle];
  return unit_or((t.position[1] - t.position[0]).cross(t.position[2] - t.position[0]),
                 Vec3f::UnitZ());
}

ScenePoint TraceScene::surface(const Hit& hit, const Vec3f& direction) const {
  const Facet& t = triangles_[hit.triangle];
  const Material& material = materials_[meshes_[t.mesh].material];
  const float a = 1 - hit.b - hit.c;
  const float weight[3] = {a, hit.b, hit.c};
  ScenePoint point;
  point.mesh = t.mesh;
  point.part = t.part;
  point.position = a * t.position[0] + hit.b * t.position[1] + hit.c * t.position[2];
  point.uv = a * t.uv[0] + hit.b * t.uv[1] + hit.c * t.uv[2];
  point.geometric = unit_or((t.position[1] - t.position[0]).cross(t.position[2] - t.position[0]),
                            Vec3f(-direction));
  point.normal =
      unit_or(a * t.normal[0] + hit.b * t.normal[1] + hit.c * t.normal[2], point.geometric);
  float texel[kTexel];
  lookup(material.texture, point.uv, texel);
  point.albedo = Vec3f(texel);
  point.roughness = texel[3];
  point.specular = material.specular_lobe ? texel[4] : -1.0f;
  const Vec3f tangent =
      unit_or(t.tangent - point.normal * point.normal.dot(t.tangent), Vec3f::UnitX());
  const float up = std::sqrt(std::max(0.0f, 1.0f - texel[5] * texel[5] - texel[6] * texel[6]));
  point.mapped =
      unit_or(texel[5] * tangent + texel[6] * t.handedness * point.normal.cross(tangent) +
                  up * point.normal,
              point.normal);
  const float side = point.geometric.dot(direction) > 0 ? -1.0f : 1.0f;
  point.scatter = side > 0 ? material.scatter_radius : Vec3f(Vec3f::Zero());
  if (point.scatter.x() > 0 && !material.scatter.empty()) {
    float share;
    sample_bilinear(material.scatter, point.uv.x() * static_cast<float>(material.scatter.width),
                    (1 - point.uv.y()) * static_cast<float>(material.scatter.height), &share);
    // Less than a hundredth of the way is not worth the noise.
    point.scatter *= share > 0.01f ? share : 0.0f;
  }
  // Where the vertices' tangent planes stand above the facet (Hanika 2021): rays that leave from
  // there do not see the facets of a smooth surface.
  point.origin = point.position;
  for (int k = 0; k < 3; ++k) {
    const float below = side * (point.position - t.position[k]).dot(t.normal[k]);
    point.origin -= weight[k] * std::min(below, 0.0f) * side * t.normal[k];
  }
  point.geometric *= side;
  point.normal *= side;
  point.mapped *= side;
  point.origin += offset_ * point.geometric;
  return point;
}

float TraceScene::transmittance(const Vec3f& origin, const Vec3f& direction, float far) const {
  if (!transparent_) return rays_->occluded(origin, direction, 0.0f, far) ? 0.0f : 1.0f;
  float passed = 1, near = 0;
  for (int layers = 0; layers < 256; ++layers) {
    const RayHit found = rays_->closest(origin, direction, near, far);
    if (found.triangle < 0) return passed;
    passed *= 1 - opacity({found.triangle, found.distance, found.b, found.c});
    if (passed < 1e-4f) return 0;
    near = found.distance * (1 + 1e-6f) + offset_;
  }
  return 0;
}

}  // namespace effigy
