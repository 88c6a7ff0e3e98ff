#include "effigy/splat/scene_parts.h"

#include <bit>
#include <cmath>
#include <cstring>

#include "effigy/base/error.h"

namespace effigy::scene_parts {
namespace {

static_assert(std::endian::native == std::endian::little, "raw arrays are little-endian");

constexpr int kLargestSide = 16384;

}  // namespace

void refuse(const Path& file, const std::string& what) {
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

float read_opacity(const Json& object, const std::string& owner, const Path& file) {
  if (!object.contains("opacity")) refuse(file, "'" + owner + "opacity' is missing.");
  const double opacity = read_number(object["opacity"], owner + "opacity", file);
  if (!(opacity >= 0.0 && opacity <= 1.0))
    refuse(file, "'" + owner + "opacity' must lie between 0 and 1.");
  return static_cast<float>(opacity);
}

void write_output(const Path& folder, const Output& output, const Planes& planes) {
  const auto channels = static_cast<size_t>(output.count);
  std::vector<float> values(planes.pixels() * channels);
  for (size_t c = 0; c < channels; ++c) {
    const float* plane = planes.plane(output.first + static_cast<int>(c));
    for (size_t i = 0; i < planes.pixels(); ++i) values[i * channels + c] = plane[i];
  }
  write_floats(folder / (std::string(output.name) + ".f32"), values);
}

bool read_upstream(const Path& folder, const Output& output, Planes& planes) {
  const Path file = folder / (std::string("upstream_") + output.name + ".f32");
  if (!std::filesystem::exists(file)) return false;
  const auto channels = static_cast<size_t>(output.count);
  const std::vector<float> values = read_floats(file, planes.pixels() * channels);
  for (size_t c = 0; c < channels; ++c) {
    float* plane = planes.plane(output.first + static_cast<int>(c));
    for (size_t i = 0; i < planes.pixels(); ++i) plane[i] = values[i * channels + c];
  }
  return true;
}

void refuse_without_upstream(const Path& folder) {
  refuse(folder,
         "has no upstream_*.f32, so there is nothing to take gradients of; leave out "
         "--gradients or write them.");
}

}  // namespace effigy::scene_parts
