#include "effigy/cli/program.h"

#include <unistd.h>

#include <cstdio>
#include <cstring>
#include <filesystem>
#include <new>

#include "effigy/base/error.h"
#include "effigy/base/progress.h"

namespace effigy {
namespace {

void print_usage(const std::vector<Command>& commands, std::FILE* out) {
  std::fputs(
      "effigy: relightable, animatable, editable Gaussian avatars without a GPU\n\n"
      "usage: effigy COMMAND [ARGUMENTS]     effigy COMMAND --help\n\n",
      out);
  for (const Command& command : commands)
    std::fprintf(out, "  %-9s %s\n", command.name, command.summary);
  std::fputs("\n  example: effigy demo -o demo\n", out);
}

std::string learn_program() {
  std::error_code error;
  const auto self = std::filesystem::read_symlink("/proc/self/exe", error);
  return (self.parent_path() / "effigy-learn").string();
}

int complain(const std::string& sentence, int code) {
  clear_progress_line();
  std::fprintf(stderr, "effigy: %s\n", sentence.c_str());
  return code;
}

}  // namespace

int complain_of_exception(bool aloud) {
  const auto end = [aloud](const std::string& sentence, int code) {
    return aloud ? complain(sentence, code) : code;
  };
  try {
    throw;
  } catch (const Interrupted& interrupted) {
    return end(interrupted.what(), 130);
  } catch (const Error& error) {
    return end(error.what(), error.exit_code());
  } catch (const std::bad_alloc&) {
    return end("Out of memory; close other programs or lower --size.", 1);
  } catch (const std::exception& problem) {
    return end(std::string("Internal error: ") + problem.what() + "; please report it.", 1);
  }
}

int run_program(const std::vector<Command>& commands, int argc, char** argv) {
  install_interrupt_handler();
  if (argc < 2) {
    print_usage(commands, stderr);
    return 2;
  }
  const std::string name = argv[1];
  if (name == "--help" || name == "-h" || name == "help") {
    print_usage(commands, stdout);
    return 0;
  }
  if (name == "--version") {
    std::puts("effigy " EFFIGY_VERSION);
    return 0;
  }
  for (const Command& command : commands) {
    if (name != command.name) continue;
    try {
      return command.run(argc - 1, argv + 1);
    } catch (const std::exception&) {
      return complain_of_exception();
    }
  }
  return complain("Unknown command '" + name + "'; see 'effigy --help'.", 2);
}

bool can_hand_over() {
  std::error_code error;
  return std::filesystem::exists(learn_program(), error);
}

int hand_over(int argc, char** argv) {
  const std::string learn = learn_program();
  std::vector<char*> arguments = {const_cast<char*>(learn.c_str())};
  for (int i = 0; i < argc; ++i) arguments.push_back(argv[i]);
  arguments.push_back(nullptr);
  execv(learn.c_str(), arguments.data());
  throw Error("Cannot start " + learn + "; build it with ./effigy or cmake --build build/release.",
              Blame::kResource);
}

}  // namespace effigy
