// effigy: every command but those that need libtorch, which it hands to effigy-learn beside it.

#include "effigy/cli/commands.h"
#include "effigy/cli/program.h"

namespace effigy {
namespace {

const std::vector<Command> kCommands = {
    {"demo", run_demo, "one command, end to end, on a built-in capture"},
    {"track", hand_over, "a talking-head video to a capture"},
    {"import", run_import, "a light-stage recording of others to a capture"},
    {"synth", run_synth, "a path-traced capture with the truth of every layer"},
    {"train", run_train, "a capture to an avatar"},
    {"render", run_render, "frames or a video of an avatar: drive, orbit, relight, buffers"},
    {"eval", run_eval, "metrics and a report against a capture"},
    {"study", run_study, "the system with and without each of its parts"},
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
