// NumPy .npy and .npz files: numeric arrays and fixed-length texts only (no pickled objects).
#pragma once

#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "effigy/base/file.h"

namespace effigy {

// An array converted to double or integers on demand; C order, little-endian (Fortran order and
// big-endian values are rearranged on reading). Values may be NaN or infinite: whoever uses them
// checks.
struct NpyArray {
  std::vector<int64_t> shape;
  char kind = 'f';     // 'f', 'i', 'u', 'b' numbers; 'S' bytes, 'U' text
  int item_bytes = 4;  // of one element ('U': 4 per character)
  std::vector<uint8_t> bytes;

  int64_t count() const;
  // Kinds f, i, u, b. Throw Error for texts.
  std::vector<float> floats() const;
  std::vector<double> doubles() const;
  // Kinds i, u, b. Throws Error for other kinds and for values above 2^63 - 1.
  std::vector<int64_t> integers() const;
  // Kinds S and U (as UTF-8), without the padding zeros. Throws Error for numbers.
  std::vector<std::string> strings() const;
};

// An array from NumPy's own description of it: a type such as "<f8" or "|S24", and memory in C or
// Fortran order, exactly as long as the shape says. Throws Error, beginning with `name`, for
// anything else.
NpyArray make_npy_array(const std::string& descr, std::vector<int64_t> shape, bool fortran_order,
                        std::span<const uint8_t> memory, const std::string& name);

// The bytes of a .npy file (versions 1 to 3). Throws Error beginning with `name`.
NpyArray parse_npy(std::span<const uint8_t> bytes, const std::string& name);
NpyArray read_npy(const Path& path);
// All arrays of an .npz file by name; entries that hold Python objects or are not arrays are passed
// over. Throws Error naming the file for a damaged one and for more than 4 GiB.
std::map<std::string, NpyArray> read_npz(const Path& path);

}  // namespace effigy
