// safetensors: named arrays in one file (8-byte header length, JSON header, raw little-endian
// data). Python, JavaScript and Rust read it, and it maps into memory.
#pragma once

#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "effigy/base/file.h"

namespace effigy {

// One named array, row-major.
struct Tensor {
  enum class Type { kF32, kI32, kU8, kI64, kF64, kF16 };
  Type type = Type::kF32;
  std::vector<int64_t> shape;
  std::vector<uint8_t> bytes;

  static Tensor from(std::span<const float> values, std::vector<int64_t> shape);
  static Tensor from(std::span<const int32_t> values, std::vector<int64_t> shape);
  static Tensor from(std::span<const int64_t> values, std::vector<int64_t> shape);
  static Tensor from(std::span<const uint8_t> values, std::vector<int64_t> shape);
  int64_t count() const;
};

struct TensorFile {
  std::map<std::string, Tensor> tensors;
  std::map<std::string, std::string> metadata;
  Path path;  // where it was read from, for messages

  bool has(const std::string& name) const { return tensors.count(name) != 0; }
  // Arrays by name and type; `shape` entries of -1 match any length. Throws Error naming file and
  // tensor when missing, of another type or shape, or (floats) not finite.
  std::vector<float> floats(const std::string& name, std::vector<int64_t> shape) const;
  std::vector<int32_t> ints(const std::string& name, std::vector<int64_t> shape) const;
  std::vector<int64_t> longs(const std::string& name, std::vector<int64_t> shape) const;
  std::vector<uint8_t> bytes(const std::string& name, std::vector<int64_t> shape) const;
  const std::vector<int64_t>& shape(const std::string& name) const;

 private:
  const Tensor& find(const std::string& name, Tensor::Type type,
                     const std::vector<int64_t>& shape) const;
};

// Throws Error naming the file for anything that is not a well-formed safetensors file.
TensorFile read_safetensors(const Path& path);
// Writes beside and renames.
void write_safetensors(const Path& path, const TensorFile& file);

}  // namespace effigy
