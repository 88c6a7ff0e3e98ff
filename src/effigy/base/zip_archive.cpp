#include "effigy/base/zip_archive.h"

#include <zip.h>

#include "effigy/base/error.h"

namespace effigy {
namespace {

constexpr zip_int64_t kMostEntries = 1'000'000;
constexpr size_t kChunk = 1 << 18;

struct FileCloser {
  void operator()(zip_file_t* file) const { zip_fclose(file); }
};

}  // namespace

void ZipArchive::Closer::operator()(zip* archive) const {
  zip_discard(archive);
}

ZipArchive::ZipArchive(const Path& path, std::string what, std::string remedy)
    : path_(path.string()), what_(std::move(what)), remedy_(std::move(remedy)) {
  int code = 0;
  archive_.reset(zip_open(path.c_str(), ZIP_RDONLY, &code));
  if (!archive_) {
    zip_error_t error;
    zip_error_init_with_code(&error, code);
    const std::string why = zip_error_strerror(&error);
    zip_error_fini(&error);
    damaged(why);
  }
  const zip_int64_t entries = zip_get_num_entries(archive_.get(), 0);
  if (entries > kMostEntries) damaged("more than a million entries");
  for (zip_int64_t i = 0; i < entries; ++i) {
    const char* name = zip_get_name(archive_.get(), static_cast<zip_uint64_t>(i), 0);
    names_.emplace_back(name != nullptr ? name : "");
  }
}

bool ZipArchive::has(const std::string& name) const {
  return zip_name_locate(archive_.get(), name.c_str(), 0) >= 0;
}

std::vector<uint8_t> ZipArchive::read(const std::string& name, uint64_t limit) const {
  const std::string entry = "the entry '" + name + "' ";
  const zip_int64_t index = zip_name_locate(archive_.get(), name.c_str(), 0);
  if (index < 0) damaged(entry + "is missing");
  const std::unique_ptr<zip_file_t, FileCloser> file(
      zip_fopen_index(archive_.get(), static_cast<zip_uint64_t>(index), 0));
  if (!file) damaged(entry + "cannot be opened");
  std::vector<uint8_t> bytes;
  std::vector<uint8_t> chunk(kChunk);
  while (true) {
    // The checksum is compared when the end is reached.
    const zip_int64_t got = zip_fread(file.get(), chunk.data(), chunk.size());
    if (got < 0) damaged(entry + "is damaged");
    if (got == 0) return bytes;
    if (static_cast<uint64_t>(got) > limit - bytes.size())
      damaged(entry + "has more than " + std::to_string(limit) + " bytes");
    bytes.insert(bytes.end(), chunk.begin(), chunk.begin() + got);
  }
}

void ZipArchive::damaged(const std::string& why) const {
  throw Error(path_ + ": not a readable " + what_ + " (" + why + "); " + remedy_ + ".");
}

}  // namespace effigy
