// Zip archives (.npz, model bundles, torch.save files), entry by entry.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "effigy/base/file.h"

struct zip;

namespace effigy {

class ZipArchive {
 public:
  // `what` and `remedy` complete the sentence of every error, also the later ones: "<path>: not a
  // readable <what> (...); <remedy>." Throws Error for a file that is missing or no archive, and
  // for more than a million entries.
  ZipArchive(const Path& path, std::string what, std::string remedy);

  const std::vector<std::string>& names() const { return names_; }
  bool has(const std::string& name) const;
  // The whole entry, by its actual length (the declared one may lie), its checksum compared. Throws
  // Error when it is missing, damaged or longer than `limit` bytes.
  std::vector<uint8_t> read(const std::string& name, uint64_t limit) const;

 private:
  struct Closer {
    void operator()(zip* archive) const;
  };
  [[noreturn]] void damaged(const std::string& why) const;
  std::string path_, what_, remedy_;
  std::unique_ptr<zip, Closer> archive_;
  std::vector<std::string> names_;
};

}  // namespace effigy
