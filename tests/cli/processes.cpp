// Training in many processes under mpirun: the bits of one process, and every way it can end.

#include <signal.h>
#include <unistd.h>

#include <chrono>
#include <fstream>
#include <iterator>
#include <thread>

#include "cli/run.h"
#include "effigy/base/json.h"
#include "lit_ball.h"

namespace effigy {
namespace {

using test::contains;
using test::Outcome;

const std::string kProgram = EFFIGY_BINARY_DIR "/bin/effigy";
const std::string kMpirun = "mpirun --allow-run-as-root --oversubscribe --bind-to none -np ";

// Made once for all tests of this file.
const Path& capture() {
  static const test::ScratchFolder scratch;
  static const bool made = (test::write_lit_ball(scratch / "capture", 7, 32), true);
  (void)made;
  static const Path path = scratch / "capture";
  return path;
}

// The same settings for every test, so that one of them may go on with what another started.
std::string training(const Path& out, int batch, const std::string& more = "") {
  return kProgram + " train " + capture().string() + " -o " + out.string() +
         " --preset quick --iterations 8 --threads 1 --set checkpoint_every=1 "
         "--set evaluate_every=4 --batch " +
         std::to_string(batch) + " " + more;
}

Outcome together(int processes, const std::string& command) {
  return test::run_command(kMpirun + std::to_string(processes) + " " + command);
}

std::string bytes_of(const Path& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

// By one process with the whole batch of four.
const Path& alone() {
  static const test::ScratchFolder scratch;
  static const Outcome outcome = test::run_command(training(scratch / "alone", 4));
  EXPECT_EQ(outcome.code, 0) << outcome.err;
  static const Path path = scratch / "alone";
  return path;
}

void expect_same_avatar(const Path& a, const Path& b) {
  int files = 0;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(a)) {
    if (!entry.is_regular_file() || entry.path().extension() == ".json") continue;
    ++files;
    EXPECT_TRUE(bytes_of(entry.path()) == bytes_of(b / entry.path().lexically_relative(a)))
        << entry.path();
  }
  EXPECT_GE(files, 4);
  const Json one = read_json(a / "training.json"), other = read_json(b / "training.json");
  for (const char* field : {"iterations", "settings", "losses", "heldout"})
    EXPECT_EQ(one[field], other[field]) << field;
}

// Sentences of the program; mpirun says more.
size_t sentences(const std::string& text) {
  size_t count = 0;
  for (size_t at = text.find("effigy: "); at != std::string::npos;
       at = text.find("effigy: ", at + 1))
    ++count;
  return count;
}

TEST(Processes, TwoGiveTheBitsOfOne) {
  const test::ScratchFolder scratch;
  const Outcome two = together(2, training(scratch / "two", 2));
  ASSERT_EQ(two.code, 0) << two.err;
  // The first process alone speaks.
  EXPECT_EQ(two.err.find("8/8"), two.err.rfind("8/8")) << two.err;
  EXPECT_EQ(read_json(scratch / "two/training.json")["processes"], 2);
  expect_same_avatar(alone(), scratch / "two");
}

TEST(Processes, FourGiveTheBitsOfOne) {
  const test::ScratchFolder scratch;
  const Outcome four = together(4, training(scratch / "four", 1));
  ASSERT_EQ(four.code, 0) << four.err;
  expect_same_avatar(alone(), scratch / "four");
}

// The processes that mpirun has started.
std::vector<pid_t> children_of(pid_t parent) {
  std::vector<pid_t> children;
  for (const auto& entry : std::filesystem::directory_iterator("/proc")) {
    const pid_t pid = std::atoi(entry.path().filename().c_str());
    if (pid <= 0) continue;
    std::ifstream stream(entry.path() / "stat");
    std::string text{std::istreambuf_iterator<char>(stream), {}};
    const size_t name_end = text.rfind(')');
    if (name_end == std::string::npos) continue;
    char state = 0;
    int parent_of = 0;
    if (std::sscanf(text.c_str() + name_end + 1, " %c %d", &state, &parent_of) == 2 &&
        parent_of == parent)
      children.push_back(pid);
  }
  return children;
}

TEST(Processes, AKilledOneEndsTheJobAndTheCheckpointIsGood) {
  const test::ScratchFolder scratch;
  const Path out = scratch / "body", said = scratch / "err";
  const std::string command =
      "exec " + kMpirun + "2 " + training(out, 2) + " >/dev/null 2>" + said.string();
  const pid_t job = fork();
  ASSERT_GE(job, 0);
  if (job == 0) {
    execl("/bin/sh", "sh", "-c", command.c_str(), nullptr);
    _exit(127);
  }
  for (int i = 0; i < 6000 && !std::filesystem::exists(out / "checkpoint.json"); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  const std::vector<pid_t> processes = children_of(job);
  ASSERT_EQ(processes.size(), 2u);
  kill(processes.back(), SIGKILL);
  int status = 0;
  ASSERT_EQ(waitpid(job, &status, 0), job);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) != 0) << status;
  EXPECT_TRUE(contains(read_text(said), "signal 9")) << read_text(said);
  ASSERT_TRUE(std::filesystem::exists(out / "checkpoint.safetensors"));
  // With another number of processes than before, and bit for bit.
  const Outcome rest = test::run_command(training(out, 4, "--resume"));
  ASSERT_EQ(rest.code, 0) << rest.err;
  EXPECT_TRUE(contains(rest.err, "going on from iteration")) << rest.err;
  EXPECT_TRUE(bytes_of(alone() / "networks.safetensors") == bytes_of(out / "networks.safetensors"));
}

TEST(Processes, AnErrorOfOneEndsAllWithOneSentence) {
  const test::ScratchFolder scratch;
  // Only the first process writes: a folder stands where its checkpoint belongs.
  make_folder(scratch / "body/checkpoint.safetensors/in-the-way");
  const Outcome full = together(2, training(scratch / "body", 1));
  EXPECT_EQ(full.code, 1) << full.err;
  EXPECT_EQ(sentences(full.err), 1u) << full.err;
  EXPECT_TRUE(contains(full.err, "checkpoint.safetensors")) << full.err;
}

TEST(Processes, WhatAllFindWrongIsSaidOnce) {
  const test::ScratchFolder scratch;
  const Outcome bad = together(2, training(scratch / "body", 1, "--set sice=tiny"));
  EXPECT_EQ(bad.code, 2) << bad.err;
  EXPECT_EQ(sentences(bad.err), 1u) << bad.err;
  EXPECT_TRUE(contains(bad.err, "sice")) << bad.err;
  const Outcome other = together(2, training(scratch / "body", 1, "--resume"));
  EXPECT_EQ(other.code, 2) << other.err;
  EXPECT_EQ(sentences(other.err), 1u) << other.err;
}

TEST(Processes, HeadsAreTrainedByOne) {
  const Outcome outcome =
      test::run_command("env OMPI_COMM_WORLD_SIZE=2 " + kProgram + " train /nonexistent -o /tmp/x");
  EXPECT_EQ(outcome.code, 2);
  EXPECT_TRUE(contains(outcome.err, "one process")) << outcome.err;
}

}  // namespace
}  // namespace effigy
