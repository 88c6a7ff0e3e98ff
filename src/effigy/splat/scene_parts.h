// What the readers of described scenes share (scene_file.h). Internal to splat/.
#pragma once

#include <string>
#include <vector>

#include "effigy/base/file.h"
#include "effigy/base/json.h"
#include "effigy/geometry/types.h"
#include "effigy/image/image.h"

namespace effigy::scene_parts {

// Throws Error("FILE: what").
[[noreturn]] void refuse(const Path& file, const std::string& what);

// A raw array of exactly `count` finite floats.
std::vector<float> read_floats(const Path& file, size_t count);
void write_floats(const Path& file, const std::vector<float>& values);

// A number of pixels or texels.
int read_side(const Json& object, const char* field, const Path& file);
// A number that single precision can hold; `name` is for the message.
double read_number(const Json& value, const std::string& name, const Path& file);
// Appends the numbers of an array, nested `rows` deep when rows > 1, row by row.
void append_numbers(const Json& object, const std::string& field, size_t rows, size_t columns,
                    const Path& file, const std::string& owner, std::vector<float>& to);
// `camera`: width height fx fy cx cy camera_from_world.
Camera read_camera(const Json& object, const Path& file);
// The opacity of `owner`, in [0, 1].
float read_opacity(const Json& object, const std::string& owner, const Path& file);

// A raw array of several planes: a file's name without its ending, and where its planes are.
struct Output {
  const char* name;
  int first, count;
};
// Interleaves planes into DIR/name.f32.
void write_output(const Path& folder, const Output& output, const Planes& planes);
// The other way round, from DIR/upstream_name.f32; false when there is no such file.
bool read_upstream(const Path& folder, const Output& output, Planes& planes);
// Refuses a folder without any upstream_*.f32.
[[noreturn]] void refuse_without_upstream(const Path& folder);

}  // namespace effigy::scene_parts
