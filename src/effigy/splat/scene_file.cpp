#include "effigy/splat/scene_file.h"

#include <bit>
#include <cmath>
#include <cstring>
#include <string>

#include "effigy/base/error.h"
#include "effigy/base/json.h"

namespace effigy {
namespace {

static_assert(std::endian::native == std::endian::little, "raw arrays are little-endian");

constexpr int kLargestSide = 16384;
constexpr size_t kMostSurfels = 10'000'000;
constexpr int kTextureChannels = 7;

// An output file and the planes of the G-buffer that it holds.
struct Output {
  const char* name;
  int first, count;
};
constexpr Output kOutputs[] = {
    {"alpha", kAlpha, 1},
    {"depth", kDepth, 1},
    {"material", kAlbedo, 5},
    {"normal", kNormal, 3},
    {"mapped_normal", kMappedNormal, 3},
    {"uv", kUv, 2},
    {"uv_distortion", kUvDistortion, 1},
};

[[noreturn]] void refuse(const Path& file, const std::string& what) {
  throw Error(file.string() + ": " + what);
}

// A raw array of exactly `count` finite floats.
std::vector<float> read_floats(const Path& file, size_t count) {
  const std::vector<uint8_t> bytes = read_file(file);
  if (bytes.size() != count * sizeof(float))
    refuse(file, "has " + std::to_string(bytes.size()) +
                     " bytes, but the sizes in scene.json need " +
                     std::to_string(count * sizeof(float)) + "; write both again.");
  std::vector<float> values(count);
  std::memcpy(values.data(), bytes.data(), bytes.size());
  for (size_t i = 0; i < count; ++i) {
    if (!std::isfinite(values[i]))
      refuse(file, "value " + std::to_string(i) + " is not finite; write the file again.");
  }
  return values;
}

void write_floats(const Path& file, const std::vector<float>& values) {
  write_file(file,
             {reinterpret_cast<const uint8_t*>(values.data()), values.size() * sizeof(float)});
}

int read_side(const Json& object, const char* field, const Path& file) {
  const auto side = json_field<double>(object, field, file);
  if (!(side >= 1 && side <= kLargestSide) || side != std::floor(side))
    refuse(file, std::string("'") + field + "' must be a whole number from 1 to " +
                     std::to_string(kLargestSide) + ".");
  return static_cast<int>(side);
}

double read_number(const Json& value, const std::string& name, const Path& file) {
  if (!value.is_number()) refuse(file, "'" + name + "' must be a number.");
  const auto number = value.get<double>();
  // Also what single precision can hold.
  if (!(std::abs(number) < 1e30)) refuse(file, "'" + name + "' is not a usable number.");
  return number;
}

// Appends the numbers of an array, nested `rows` deep when rows > 1, row by row.
void append_numbers(const Json& object, const std::string& field, size_t rows, size_t columns,
                    const Path& file, const std::string& owner, std::vector<float>& to) {
  const std::string name = owner + field;
  const auto found = object.find(field);
  if (found == object.end()) refuse(file, "'" + name + "' is missing.");
  const auto append_row = [&](const Json& row) {
    if (!row.is_array() || row.size() != columns)
      refuse(file, "'" + name + "' must have " + std::to_string(rows) + " x " +
                       std::to_string(columns) + " numbers.");
    for (const Json& value : row) to.push_back(static_cast<float>(read_number(value, name, file)));
  };
  if (rows == 1) {
    append_row(*found);
    return;
  }
  if (!found->is_array() || found->size() != rows)
    refuse(file, "'" + name + "' must have " + std::to_string(rows) + " rows.");
  for (const Json& row : *found) append_row(row);
}

Camera read_camera(const Json& object, const Path& file) {
  if (!object.is_object()) refuse(file, "'camera' is missing or not an object.");
  Camera camera;
  camera.width = read_side(object, "width", file);
  camera.height = read_side(object, "height", file);
  const auto number = [&](const char* field) {
    if (!object.contains(field)) refuse(file, std::string("'camera.") + field + "' is missing.");
    return read_number(object[field], std::string("camera.") + field, file);
  };
  camera.fx = number("fx");
  camera.fy = number("fy");
  camera.cx = number("cx");
  camera.cy = number("cy");
  if (!(camera.fx > 0.0 && camera.fy > 0.0)) refuse(file, "'camera.fx' and 'fy' must be positive.");
  const auto found = object.find("camera_from_world");
  if (found == object.end() || !found->is_array() || found->size() != 4)
    refuse(file, "'camera.camera_from_world' must be a 4 x 4 matrix.");
  Mat4d m;
  for (size_t r = 0; r < 4; ++r) {
    const Json& row = (*found)[r];
    if (!row.is_array() || row.size() != 4)
      refuse(file, "'camera.camera_from_world' must be a 4 x 4 matrix.");
    for (size_t c = 0; c < 4; ++c)
      m(static_cast<int>(r), static_cast<int>(c)) =
          read_number(row[c], "camera.camera_from_world", file);
  }
  camera.camera_from_world_rotation = m.topLeftCorner<3, 3>();
  camera.camera_from_world_translation = m.topRightCorner<3, 1>();
  const Mat3d& rotation = camera.camera_from_world_rotation;
  const bool rigid = (rotation * rotation.transpose() - Mat3d::Identity()).norm() < 1e-3 &&
                     rotation.determinant() > 0.0 &&
                     (m.row(3) - Eigen::RowVector4d(0, 0, 0, 1)).norm() < 1e-6;
  if (!rigid)
    refuse(file,
           "'camera.camera_from_world' is not a rotation and a translation (rows of the "
           "rotation orthonormal, determinant +1, last row 0 0 0 1).");
  return camera;
}

MaterialTexture read_texture(const Json& object, const Path& folder, const Path& file) {
  if (!object.is_object()) refuse(file, "'texture' is missing or not an object.");
  MaterialTexture texture(read_side(object, "width", file), read_side(object, "height", file));
  const Path name = json_field<std::string>(object, "file", file);
  if (name.empty() || name.is_absolute() || name.has_parent_path() || name == "..")
    refuse(file, "'texture.file' must be the name of a file in the scene's folder.");
  const size_t texels = texture.texels.size() / 8;
  const std::vector<float> values = read_floats(folder / name, texels * kTextureChannels);
  for (size_t i = 0; i < texels; ++i)
    std::memcpy(&texture.texels[8 * i], &values[kTextureChannels * i],
                sizeof(float) * kTextureChannels);
  return texture;
}

}  // namespace

SplatScene read_splat_scene(const Path& folder) {
  const Path file = folder / "scene.json";
  const Json json = read_json(file);
  if (!json.is_object()) refuse(file, "must be a JSON object with camera, texture and surfels.");
  const auto kind = json_field_or<std::string>(json, "kind", file, "surfels");
  if (kind == "gaussians")
    refuse(file,
           "describes 3D Gaussians, and this version draws surfels only; give a scene with "
           "'surfels'.");
  if (kind != "surfels") refuse(file, "'kind' is '" + kind + "'; it must be 'surfels'.");
  SplatScene scene;
  scene.camera = read_camera(json.contains("camera") ? json["camera"] : Json(), file);
  scene.texture = read_texture(json.contains("texture") ? json["texture"] : Json(), folder, file);
  if (!json.contains("surfels") || !json["surfels"].is_array())
    refuse(file, "'surfels' is missing or not an array.");
  const Json& surfels = json["surfels"];
  if (surfels.size() > kMostSurfels)
    refuse(file, "more than " + std::to_string(kMostSurfels) + " surfels cannot be drawn.");
  PosedSurfels& posed = scene.surfels;
  for (size_t i = 0; i < surfels.size(); ++i) {
    const Json& surfel = surfels[i];
    const std::string owner = "surfels[" + std::to_string(i) + "].";
    if (!surfel.is_object()) refuse(file, "'surfels[" + std::to_string(i) + "]' is not an object.");
    append_numbers(surfel, "center", 1, 3, file, owner, posed.center);
    append_numbers(surfel, "s", 1, 3, file, owner, posed.s);
    append_numbers(surfel, "t", 1, 3, file, owner, posed.t);
    append_numbers(surfel, "uv", 1, 2, file, owner, posed.uv);
    append_numbers(surfel, "uv_per_st", 2, 2, file, owner, posed.uv_per_st);
    append_numbers(surfel, "frame", 3, 3, file, owner, posed.frame);
    if (!surfel.contains("opacity")) refuse(file, "'" + owner + "opacity' is missing.");
    const double opacity = read_number(surfel["opacity"], owner + "opacity", file);
    if (!(opacity >= 0.0 && opacity <= 1.0))
      refuse(file, "'" + owner + "opacity' must lie between 0 and 1.");
    posed.opacity.push_back(static_cast<float>(opacity));
  }
  return scene;
}

SurfelRasterOptions splat_scene_options() {
  SurfelRasterOptions options;
  options.low_pass = false;
  options.near = 0.01f;
  options.uv_distortion = UvDistortion::kNorm;
  options.uv_distortion_threshold = 0.0f;
  return options;
}

Planes read_splat_upstream(const Path& folder, const Camera& camera) {
  Planes planes(camera.width, camera.height, kGBufferPlanes);
  bool any = false;
  for (const Output& output : kOutputs) {
    const Path file = folder / (std::string("upstream_") + output.name + ".f32");
    if (!std::filesystem::exists(file)) continue;
    any = true;
    const auto channels = static_cast<size_t>(output.count);
    const std::vector<float> values = read_floats(file, planes.pixels() * channels);
    for (size_t c = 0; c < channels; ++c) {
      float* plane = planes.plane(output.first + static_cast<int>(c));
      for (size_t i = 0; i < planes.pixels(); ++i) plane[i] = values[i * channels + c];
    }
  }
  if (!any)
    refuse(folder,
           "has no upstream_*.f32, so there is nothing to take gradients of; leave out "
           "--gradients or write them.");
  return planes;
}

void write_splat_outputs(const Path& folder, const Planes& gbuffer) {
  for (const Output& output : kOutputs) {
    const auto channels = static_cast<size_t>(output.count);
    std::vector<float> values(gbuffer.pixels() * channels);
    for (size_t c = 0; c < channels; ++c) {
      const float* plane = gbuffer.plane(output.first + static_cast<int>(c));
      for (size_t i = 0; i < gbuffer.pixels(); ++i) values[i * channels + c] = plane[i];
    }
    write_floats(folder / (std::string(output.name) + ".f32"), values);
  }
}

void write_splat_gradients(const Path& folder, const PosedSurfels& d_surfels,
                           const std::vector<float>& d_texels) {
  write_floats(folder / "grad_center.f32", d_surfels.center);
  write_floats(folder / "grad_s.f32", d_surfels.s);
  write_floats(folder / "grad_t.f32", d_surfels.t);
  write_floats(folder / "grad_opacity.f32", d_surfels.opacity);
  write_floats(folder / "grad_uv.f32", d_surfels.uv);
  write_floats(folder / "grad_uv_per_st.f32", d_surfels.uv_per_st);
  write_floats(folder / "grad_frame.f32", d_surfels.frame);
  std::vector<float> texture(d_texels.size() / 8 * kTextureChannels);
  for (size_t i = 0; i < d_texels.size() / 8; ++i)
    std::memcpy(&texture[kTextureChannels * i], &d_texels[8 * i], sizeof(float) * kTextureChannels);
  write_floats(folder / "grad_texture.f32", texture);
}

}  // namespace effigy
