// NumPy .npy and .npz files: numeric arrays only (no pickled objects).
#pragma once

#include <map>
#include <span>
#include <string>
#include <vector>

#include "effigy/base/file.h"

namespace effigy {

// A numeric array converted to double or integers on demand; C order (Fortran order is transposed
// on reading).
struct NpyArray {
  std::vector<int64_t> shape;
  char kind = 'f';            // 'f', 'i', 'u', 'b', 'S'
  int item_bytes = 4;
  std::vector<uint8_t> bytes;
  int64_t count() const;
  std::vector<float> floats() const;
  std::vector<double> doubles() const;
  std::vector<int64_t> integers() const;
  std::vector<std::string> strings() const;  // kind 'S'
};

NpyArray parse_npy(std::span<const uint8_t> bytes, const std::string& name);
NpyArray read_npy(const Path& path);
std::map<std::string, NpyArray> read_npz(const Path& path);

}  // namespace effigy
