// Files: whole reads with clear errors, and writes that never leave a half-written file or folder
// under its final name.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <span>
#include <string>
#include <vector>

namespace effigy {

using Path = std::filesystem::path;

// The whole file. Throws Error naming the file when it is missing, unreadable, or larger than
// `limit` bytes.
std::vector<uint8_t> read_file(const Path& path, uint64_t limit = uint64_t{4} << 30);
std::string read_text(const Path& path, uint64_t limit = uint64_t{256} << 20);

// Writes beside `path` and renames into place. Creates missing parent folders. Throws
// Error(kResource) when the disk is full or the place is not writable; what stood there stays.
void write_file(const Path& path, std::span<const uint8_t> bytes);
void write_text(const Path& path, const std::string& text);
// For writers that want a file name: `write` gets a temporary path beside the final one (same
// extension).
void write_through(const Path& path, const std::function<void(const Path& temporary)>& write);

// A folder that appears complete or not at all: fill dir(), then commit(). When the final folder
// exists already it is replaced only by commit(); without commit() the temporary one is removed.
// Only a folder that is empty or holds a file named `marker` (one of ours) is ever replaced; for
// others the constructor throws Error(kResource), so that nobody's files are lost.
class FolderWriter {
 public:
  explicit FolderWriter(Path final_path, const std::string& marker = {});
  ~FolderWriter();
  FolderWriter(const FolderWriter&) = delete;
  FolderWriter& operator=(const FolderWriter&) = delete;
  const Path& dir() const { return temporary_; }
  void commit();

 private:
  Path final_, temporary_;
  bool committed_ = false;
};

// Creates the folder and its parents; throws Error(kResource) naming it.
void make_folder(const Path& path);

}  // namespace effigy
