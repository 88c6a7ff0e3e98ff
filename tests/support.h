// Shared by tests: scratch folders, a tiny rig and capture, environment of outside data.
#pragma once

#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <string>

#include "effigy/base/error.h"
#include "effigy/base/file.h"

namespace effigy::test {

// A folder that is removed when the test ends.
class ScratchFolder {
 public:
  ScratchFolder() {
    static int counter = 0;
    path_ = std::filesystem::temp_directory_path() /
            ("effigy-test-" + std::to_string(::getpid()) + "-" + std::to_string(counter++));
    std::filesystem::create_directories(path_);
  }
  ~ScratchFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  const Path& path() const { return path_; }
  Path operator/(const std::string& name) const { return path_ / name; }

 private:
  Path path_;
};

// Folder named by an environment variable, or empty.
inline Path outside_data(const char* variable) {
  const char* value = std::getenv(variable);
  return value != nullptr && std::filesystem::is_directory(value) ? Path(value) : Path();
}

// Runs `body` and returns the sentence of the Error it throws; fails the test when none is thrown.
template <typename Body>
std::string error_of(Body&& body) {
  try {
    body();
  } catch (const Error& error) {
    return error.what();
  }
  ADD_FAILURE() << "no Error was thrown";
  return {};
}

inline bool contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

}  // namespace effigy::test
