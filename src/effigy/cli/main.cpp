// effigy: every command but those that need libtorch, which it hands to effigy-learn beside it.

#include <unistd.h>

#include <cstdio>
#include <filesystem>

#include "effigy/base/error.h"
#include "effigy/cli/commands.h"
#include "effigy/cli/program.h"

namespace effigy {
namespace {

// Replaces this process by effigy-learn with the same arguments.
int hand_over(int argc, char** argv) {
  std::error_code error;
  const auto self = std::filesystem::read_symlink("/proc/self/exe", error);
  const std::string learn = (self.parent_path() / "effigy-learn").string();
  std::vector<char*> arguments = {const_cast<char*>(learn.c_str())};
  for (int i = 0; i < argc; ++i) arguments.push_back(argv[i]);
  arguments.push_back(nullptr);
  execv(learn.c_str(), arguments.data());
  throw Error("Cannot start " + learn + "; build it with ./effigy or cmake --build build/release.",
              Blame::kResource);
}

const std::vector<Command> kCommands = {
    {"demo", run_demo, "one command, end to end, on a built-in capture"},
    {"track", hand_over, "a talking-head video to a capture"},
    {"train", run_train, "a capture to an avatar"},
    {"render", run_render, "frames or a video of an avatar: drive, orbit, relight, buffers"},
    {"eval", run_eval, "metrics and a report against a capture"},
    {"textures", run_textures, "export textures for painting, apply painted ones"},
    {"splat", run_splat, "the bare rasterizer on a described scene"},
    {"info", run_info, "what a file or folder is, and whether it is sound"},
    {"bench", run_bench, "the numbers of BENCHMARKS.md on this machine"},
};

}  // namespace
}  // namespace effigy

int main(int argc, char** argv) {
  return effigy::run_program(effigy::kCommands, argc, argv);
}
