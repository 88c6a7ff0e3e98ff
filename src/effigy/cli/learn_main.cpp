// effigy-learn: the commands that need libtorch. Users call them through effigy.

#include "effigy/cli/commands.h"
#include "effigy/cli/program.h"

int main(int argc, char** argv) {
  return effigy::run_program(
      {{"demo", effigy::run_demo_body, "one command, end to end, on a built-in body"},
       {"track", effigy::run_track, "a talking-head video to a capture"},
       {"train", effigy::run_train_body, "a light-stage capture of a body to an avatar"},
       {"render", effigy::run_render_body, "frames or a video of a body avatar"},
       {"eval", effigy::run_eval_learn, "metrics and a report, with perceptual distances"},
       {"study", effigy::run_study_learn, "a body avatar and the paper's baselines"},
       {"bench", effigy::run_bench_learn, "the networks of bodies on this machine"}},
      argc, argv);
}
