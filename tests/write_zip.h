// Zip archives for tests of their readers.
#pragma once

#include <gtest/gtest.h>
#include <zip.h>

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "effigy/base/file.h"

namespace effigy::test {

using ZipEntries = std::vector<std::pair<std::string, std::vector<uint8_t>>>;

inline void write_zip(const Path& path, const ZipEntries& entries) {
  std::filesystem::create_directories(path.parent_path());
  int code = 0;
  zip_t* archive = zip_open(path.c_str(), ZIP_CREATE | ZIP_TRUNCATE, &code);
  ASSERT_NE(archive, nullptr);
  for (const auto& [name, bytes] : entries)
    zip_file_add(archive, name.c_str(), zip_source_buffer(archive, bytes.data(), bytes.size(), 0),
                 ZIP_FL_OVERWRITE);
  ASSERT_EQ(zip_close(archive), 0);
}

}  // namespace effigy::test
