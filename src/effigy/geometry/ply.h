// PLY files: the vertices as a table of numbers. Other elements are checked and passed over.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "effigy/base/file.h"

namespace effigy {

struct PlyVertices {
  std::vector<std::string> columns;   // names of the scalar properties, in the file's order
  std::vector<float> values;          // row by row; may hold NaN and infinities
  std::vector<std::string> comments;  // without the word "comment"

  size_t count() const { return columns.empty() ? 0 : values.size() / columns.size(); }
  // Column by name; -1 when there is none.
  int find(const std::string& column) const;
};

// Reads ascii and binary_little_endian files. Throws Error naming the file when its header is
// damaged, when it does not have exactly the size that the header says, or when a vertex holds a
// list.
PlyVertices read_ply_vertices(const Path& path);
// The same from memory; `name` is for messages.
PlyVertices parse_ply_vertices(std::vector<uint8_t> bytes, const std::string& name);

// Writes binary_little_endian floats.
void write_ply_vertices(const Path& path, const PlyVertices& vertices);

}  // namespace effigy
