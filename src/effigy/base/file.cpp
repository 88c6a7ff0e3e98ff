#include "effigy/base/file.h"

#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstring>
#include <fstream>

#include "effigy/base/error.h"

namespace effigy {
namespace {

namespace fs = std::filesystem;

Path temporary_beside(const Path& path) {
  static std::atomic<unsigned> counter{0};
  const std::string tag =
      "." + std::to_string(getpid()) + "-" + std::to_string(counter++) + ".part";
  Path name = path.filename();
  return path.parent_path() / ("." + name.stem().string() + tag + name.extension().string());
}

[[noreturn]] void fail_write(const Path& path, const std::string& why) {
  throw Error("Cannot write " + path.string() + ": " + why + "; choose another place with -o.",
              Blame::kResource);
}

void rename_into_place(const Path& from, const Path& to) {
  std::error_code error;
  fs::rename(from, to, error);
  if (error) {
    const std::string why = error.message();
    fs::remove_all(from, error);
    fail_write(to, why);
  }
}

}  // namespace

void make_folder(const Path& path) {
  if (path.empty()) return;
  std::error_code error;
  fs::create_directories(path, error);
  if (error || !fs::is_directory(path))
    fail_write(path, error ? error.message() : std::string("a file of that name is in the way"));
}

std::vector<uint8_t> read_file(const Path& path, uint64_t limit) {
  std::error_code error;
  if (!fs::exists(path, error))
    throw Error("Cannot read " + path.string() + ": there is no such file; check the path.");
  if (fs::is_directory(path, error))
    throw Error("Cannot read " + path.string() + ": it is a folder, a file is expected here.");
  std::ifstream stream(path, std::ios::binary);
  if (!stream)
    throw Error("Cannot read " + path.string() + ": " + std::strerror(errno) +
                "; check its permissions.");
  const uint64_t size = fs::file_size(path, error);
  if (!error && size > limit)
    throw Error("Cannot read " + path.string() + ": it has " + std::to_string(size) +
                " bytes, at most " + std::to_string(limit) + " are expected here.");
  std::vector<uint8_t> bytes(error ? 0 : size);
  stream.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  if (static_cast<size_t>(stream.gcount()) != bytes.size())
    throw Error("Cannot read " + path.string() + ": it ended early; copy it again.");
  return bytes;
}

std::string read_text(const Path& path, uint64_t limit) {
  const auto bytes = read_file(path, limit);
  return {bytes.begin(), bytes.end()};
}

void write_through(const Path& path, const std::function<void(const Path&)>& write) {
  make_folder(path.parent_path());
  const Path temporary = temporary_beside(path);
  try {
    write(temporary);
  } catch (...) {
    std::error_code ignored;
    fs::remove(temporary, ignored);
    throw;
  }
  rename_into_place(temporary, path);
}

void write_file(const Path& path, std::span<const uint8_t> bytes) {
  write_through(path, [&](const Path& temporary) {
    std::ofstream stream(temporary, std::ios::binary);
    if (!stream) fail_write(path, std::strerror(errno));
    stream.write(reinterpret_cast<const char*>(bytes.data()),
                 static_cast<std::streamsize>(bytes.size()));
    stream.flush();
    if (!stream) fail_write(path, errno == ENOSPC ? "the disk is full" : std::strerror(errno));
  });
}

void write_text(const Path& path, const std::string& text) {
  write_file(path, {reinterpret_cast<const uint8_t*>(text.data()), text.size()});
}

FolderWriter::FolderWriter(Path final_path, const std::string& marker)
    : final_(std::move(final_path)) {
  if (final_.filename().empty()) final_ = final_.parent_path();
  if (fs::exists(final_) && !fs::is_directory(final_))
    fail_write(final_, "a file of that name is in the way");
  if (fs::is_directory(final_) && !fs::is_empty(final_) &&
      (marker.empty() || !fs::exists(final_ / marker)))
    fail_write(final_, "a folder with other files is in the way");
  make_folder(final_.parent_path());
  temporary_ = temporary_beside(final_);
  make_folder(temporary_);
}

FolderWriter::~FolderWriter() {
  if (committed_) return;
  std::error_code ignored;
  fs::remove_all(temporary_, ignored);
}

void FolderWriter::commit() {
  std::error_code error;
  Path old;
  if (fs::exists(final_)) {
    old = temporary_beside(final_);
    rename_into_place(final_, old);
  }
  fs::rename(temporary_, final_, error);
  if (error) {
    const std::string why = error.message();
    if (!old.empty()) fs::rename(old, final_, error);
    fail_write(final_, why);
  }
  committed_ = true;
  if (!old.empty()) fs::remove_all(old, error);
}

}  // namespace effigy
