// Every #include points down the floors of docs/architecture.md.

#include <fstream>
#include <map>
#include <regex>

#include "support.h"

namespace effigy {
namespace {

TEST(Layers, IncludesPointDown) {
  const std::map<std::string, int> floor = {
      {"base", 1},   {"image", 2},   {"geometry", 2}, {"rays", 3},  {"rig", 3},
      {"light", 3},  {"report", 3},  {"splat", 4},    {"shade", 5}, {"people", 4},
      {"avatar", 6}, {"capture", 5}, {"infer", 6},    {"track", 7}, {"synth", 6},
      {"learn", 7},  {"head", 8},    {"body", 8},     {"cli", 9}};
  const std::regex include("#include \"effigy/(\\w+)/");
  int seen = 0;
  for (const auto& entry :
       std::filesystem::recursive_directory_iterator(EFFIGY_SOURCE_DIR "/src/effigy")) {
    const Path path = entry.path();
    if (path.extension() != ".h" && path.extension() != ".cpp") continue;
    const std::string room = path.parent_path().filename().string();
    ASSERT_TRUE(floor.count(room)) << path << ": a room that docs/architecture.md does not name";
    std::ifstream stream(path);
    for (std::string line; std::getline(stream, line);) {
      std::smatch match;
      if (!std::regex_search(line, match, include)) continue;
      ++seen;
      const std::string other = match[1];
      EXPECT_TRUE(other == room || (floor.count(other) && floor.at(other) < floor.at(room)))
          << path << " includes " << other;
    }
  }
  EXPECT_GT(seen, 100);
}

TEST(Layers, TorchStaysWhereItBelongs) {
  for (const auto& entry :
       std::filesystem::recursive_directory_iterator(EFFIGY_SOURCE_DIR "/src/effigy")) {
    const Path path = entry.path();
    if (path.extension() != ".h" && path.extension() != ".cpp") continue;
    const std::string room = path.parent_path().filename().string();
    const std::string text = read_text(path);
    if (text.find("#include <torch/") != std::string::npos ||
        text.find("#include <ATen/") != std::string::npos) {
      EXPECT_TRUE(room == "infer" || room == "body" || path.stem() == "layers") << path;
    }
    // Headers that bring libtorch's along.
    for (const char* header :
         {"effigy/infer/convolution.h", "effigy/learn/layers.h", "effigy/body/network_modules.h"})
      if (text.find(std::string("#include \"") + header) != std::string::npos) {
        EXPECT_TRUE(room == "infer" || room == "body" || path.stem() == "layers") << path;
      }
    if (text.find("#include <mpi.h>") != std::string::npos) {
      EXPECT_EQ(path.filename(), "mpi_ranks.cpp") << path;
    }
    if (text.find("#include <libav") != std::string::npos && path.filename() != "ffmpeg.h" &&
        path.filename() != "avif.cpp") {
      EXPECT_EQ(path.filename().string().rfind("video", 0), 0u) << path;
    }
  }
}

}  // namespace
}  // namespace effigy
