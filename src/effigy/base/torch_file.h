// Tensors by name from the files that Python's torch.save writes of a state_dict: the zip container
// (PyTorch 1.6 and later) and the older one (pickles, then raw storages). Nothing of the file is
// executed (base/pickle.h).
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "effigy/base/file.h"

namespace effigy {

class ZipArchive;

class TorchFile {
 public:
  // Reads the names and shapes; numbers stay on disk until they are asked for. Throws Error naming
  // the file when it is missing, damaged, of another kind, or asks for Python objects other than
  // tensors.
  explicit TorchFile(const Path& path);
  ~TorchFile();
  TorchFile(TorchFile&&) noexcept;

  const Path& path() const { return path_; }
  bool has(const std::string& name) const { return tensors_.count(name) != 0; }
  // In the order of the alphabet.
  std::vector<std::string> names() const;
  // Sides of a tensor that has() says is there.
  const std::vector<int64_t>& shape(const std::string& name) const;
  // For messages: "64x3x3x3".
  static std::string sides(const std::vector<int64_t>& shape);
  // Its numbers in C order; 16, 32 and 64 bit floating point. Throws Error naming file and tensor
  // when it holds integers or values that are not finite, or is damaged.
  std::vector<float> read(const std::string& name) const;

 private:
  friend class TorchDirectory;
  struct Storage {
    std::string key, type;  // type: "FloatStorage", ...
    uint64_t count = 0;
    uint64_t begin = 0;  // offset of its data in the file; zip container: not used
  };
  struct Tensor {
    size_t storage = 0;
    uint64_t offset = 0;
    std::vector<int64_t> shape, strides;
  };
  std::vector<uint8_t> storage_bytes(const Storage& storage) const;

  Path path_;
  std::vector<Storage> storages_;
  std::map<std::string, Tensor> tensors_;
  std::unique_ptr<ZipArchive> archive_;  // zip container only
  std::string prefix_;                   // "archive/"
};

}  // namespace effigy
