// effigy-learn: the commands that need libtorch. Users call them through effigy.

#include "effigy/cli/commands.h"
#include "effigy/cli/program.h"

int main(int argc, char** argv) {
  return effigy::run_program(
      {{"track", effigy::run_track, "a talking-head video to a capture"},
       {"eval", effigy::run_eval_learn, "metrics and a report, with perceptual distances"}},
      argc, argv);
}
