// The commands: one function in one file each. argv[0] is the command's name. Return an exit code
// or throw Error.
#pragma once

namespace effigy {

int run_demo(int argc, char** argv);
int run_demo_body(int argc, char** argv);  // effigy-learn
int run_synth(int argc, char** argv);
int run_track(int argc, char** argv);  // effigy-learn
int run_train(int argc, char** argv);
int run_train_body(int argc, char** argv);  // effigy-learn
int run_import(int argc, char** argv);
int run_render(int argc, char** argv);
int run_render_body(int argc, char** argv);  // effigy-learn
int run_eval(int argc, char** argv);
int run_eval_learn(int argc, char** argv);  // effigy-learn
int run_textures(int argc, char** argv);
int run_splat(int argc, char** argv);
int run_study(int argc, char** argv);
int run_study_learn(int argc, char** argv);  // effigy-learn
int run_info(int argc, char** argv);
int run_bench(int argc, char** argv);
int run_bench_learn(int argc, char** argv);  // effigy-learn

}  // namespace effigy
