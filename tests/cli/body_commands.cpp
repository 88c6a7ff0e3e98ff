// The commands on body avatars: results, exit codes and the one sentence of each error.

#include "cli/run.h"
#include "effigy/base/json.h"
#include "effigy/base/safetensors.h"
#include "lit_ball.h"

namespace effigy {
namespace {

using test::contains;
using test::Outcome;
using test::run;

// A small trained body and its capture, made once for all tests of this file.
const Path& trained() {
  static const test::ScratchFolder scratch;
  static const bool made = [] {
    test::write_lit_ball(scratch / "capture", 7, 40, true);
    const Outcome train =
        run("train " + (scratch / "capture").string() + " -o " + (scratch / "body").string() +
            " --preset quick --iterations 30 --set evaluate_every=10 --consent 'a test' --json");
    EXPECT_EQ(train.code, 0) << train.err;
    const Json result = Json::parse(train.out);
    EXPECT_EQ(result["iterations"], 30);
    EXPECT_EQ(result["heldout"].size(), 3u);
    return true;
  }();
  (void)made;
  return scratch.path();
}

std::string body() {
  return (trained() / "body").string();
}
std::string capture() {
  return (trained() / "capture").string();
}

void expect_sentence(const std::string& arguments, const std::string& part) {
  const Outcome outcome = run(arguments);
  EXPECT_EQ(outcome.code, 2) << arguments << ": " << outcome.err;
  EXPECT_TRUE(outcome.one_sentence()) << arguments << ": " << outcome.err;
  EXPECT_TRUE(contains(outcome.err, part)) << arguments << ": " << outcome.err;
}

TEST(BodyCommands, HelpNamesTheOptionsOfBodies) {
  const Outcome train = run("train " + capture() + " --help");
  EXPECT_EQ(train.code, 0);
  EXPECT_TRUE(contains(train.out, "--size"));
  const Outcome render = run("render " + body() + " --help");
  EXPECT_EQ(render.code, 0);
  EXPECT_TRUE(contains(render.out, "--point-light"));
  EXPECT_TRUE(contains(run("demo body --help").out, "light-stage"));
  EXPECT_TRUE(contains(run("study body --list").out, "PBR appearance"));
}

TEST(BodyCommands, EvalScoresEveryGroup) {
  const test::ScratchFolder out;
  const Outcome eval = run("eval " + body() + " " + capture() + " -o " + out.path().string() +
                           " --lpips none --json");
  ASSERT_EQ(eval.code, 0) << eval.err;
  const Json metrics = Json::parse(eval.out);
  for (const char* group : {"view", "motion"}) {
    ASSERT_TRUE(metrics.contains(group));
    EXPECT_GT(metrics[group]["psnr"].get<double>(), 12.0);
    EXPECT_GT(metrics[group]["ssim"].get<double>(), 0.3);
    EXPECT_TRUE(metrics[group].contains("mean_colour"));
    EXPECT_TRUE(metrics[group].contains("left_fully_lit"));
    EXPECT_LT(metrics[group]["depth_error_mm"], 15);
    EXPECT_LT(metrics[group]["normal_degrees"], 40);
    EXPECT_LT(metrics[group]["albedo_error"], 0.3);
    EXPECT_TRUE(metrics[group].contains("roughness_error"));
  }
  const Json& even = metrics["relight"]["even"];
  EXPECT_NEAR(even["psnr"], metrics["environment"]["psnr"], 1e-6);
  EXPECT_GT(even["scale"], 0.2);
  EXPECT_GT(even["psnr_aligned"], even["psnr"].get<double>() - 0.1);
  EXPECT_TRUE(even.contains("ssim_aligned") && even.contains("psnr_unlit"));
  EXPECT_EQ(metrics, read_json(out / "metrics.json"));
  EXPECT_TRUE(contains(read_text(out / "report.html"), "held-out cameras"));
}

TEST(BodyCommands, ShardsOfEvalMergeToTheWhole) {
  const test::ScratchFolder out;
  const std::string command = "eval " + body() + " " + capture() + " --views 2 --lpips none -o ";
  const std::string parts = command + (out / "parts").string();
  ASSERT_EQ(run(command + (out / "whole").string()).code, 0);
  EXPECT_TRUE(contains(run(parts + " --merge").err, "no shards"));
  for (const int i : {2, 0}) {
    const Outcome shard = run(parts + " --shard " + std::to_string(i) + "/3");
    ASSERT_EQ(shard.code, 0) << shard.err;
  }
  EXPECT_FALSE(std::filesystem::exists(out / "parts/metrics.json"));
  const Outcome early = run(parts + " --merge");
  EXPECT_EQ(early.code, 2);
  EXPECT_TRUE(early.one_sentence() && contains(early.err, "1-of-3.json is missing")) << early.err;
  std::string other = parts;
  other.replace(other.find("--views 2"), 9, "--views 1");
  ASSERT_EQ(run(other + " --shard 1/3").code, 0);
  EXPECT_TRUE(contains(run(parts + " --merge").err, "other options"));
  ASSERT_EQ(run(parts + " --shard 1/3").code, 0);
  const Outcome merge = run(parts + " --merge");
  ASSERT_EQ(merge.code, 0) << merge.err;
  Json whole = read_json(out / "whole/metrics.json"),
       merged = read_json(out / "parts/metrics.json");
  EXPECT_GT(merged["seconds"], 0);
  whole.erase("seconds");
  merged.erase("seconds");
  EXPECT_EQ(whole, merged);
  EXPECT_EQ(read_text(out / "whole/report.html"), read_text(out / "parts/report.html"));
  expect_sentence(parts + " --shard 3/3", "--shard");
  expect_sentence(parts + " --shard 1of3", "--shard");
  expect_sentence(parts + " --shard 0/3 --merge", "--merge");
  ASSERT_EQ(run(parts + " --shard 0/2").code, 0);
  expect_sentence(parts + " --merge", "remove those of an earlier run");
}

TEST(BodyCommands, ShardsOfRenderMergeToTheWhole) {
  const test::ScratchFolder out;
  const std::string command = "render " + body() + " --count 3 --size 32 --camera orbit -o ";
  ASSERT_EQ(run(command + (out / "whole").string()).code, 0);
  for (const char* shard : {"0/2", "1/2"})
    ASSERT_EQ(run(command + (out / "parts").string() + " --shard " + shard).code, 0);
  for (int f = 0; f < 3; ++f) {
    const std::string name = "rgb/00000" + std::to_string(f) + ".png";
    EXPECT_EQ(read_file(out / "whole" / name), read_file(out / "parts" / name));
  }
}

TEST(BodyCommands, RenderByEnvironmentAndLamps) {
  const test::ScratchFolder out;
  const Outcome sky = run("render " + body() + " -o " + (out / "sky").string() +
                          " --light overcast --count 2 --buffers normal,shadow --size 32");
  ASSERT_EQ(sky.code, 0) << sky.err;
  const Image8 frame = read_image8(out / "sky/rgb/000001.png");
  EXPECT_EQ(frame.height, 32);
  EXPECT_GT(*std::max_element(frame.data.begin(), frame.data.end()), 60);
  EXPECT_TRUE(std::filesystem::exists(out / "sky/shadow/000000.png"));
  EXPECT_TRUE(contains(read_image_metadata(out / "sky/rgb/000000.png")["Comment"], "Synthetic"));
  const Outcome lamps = run("render " + body() + " -o " + (out / "lamps").string() +
                            " --point-light 1,1,1,3,0,0 --point-light -1,1,1,0,0,3 --count 1 "
                            "--turn-light 90 --background 0.5,0.5,0.5 --ground -0.1");
  ASSERT_EQ(lamps.code, 0) << lamps.err;
}

TEST(BodyCommands, TexturesAndInfo) {
  const test::ScratchFolder out;
  ASSERT_EQ(run("textures " + body() + " export " + (out / "maps").string()).code, 0);
  EXPECT_TRUE(std::filesystem::exists(out / "maps/albedo.png"));
  EXPECT_FALSE(std::filesystem::exists(out / "maps/normal.png"));
  std::filesystem::copy(body(), out / "copy", std::filesystem::copy_options::recursive);
  const Outcome apply = run("textures " + (out / "copy").string() + " apply " +
                            (out / "maps").string() + " --rect 0.2,0.2,0.6,0.6");
  EXPECT_EQ(apply.code, 0) << apply.err;
  const Outcome info = run("info " + (out / "copy").string() + " --json");
  ASSERT_EQ(info.code, 0) << info.err;
  const Json json = Json::parse(info.out);
  EXPECT_EQ(json["kind"], "body");
  EXPECT_EQ(json["provenance"]["consent"], "a test");
  EXPECT_GT(json["gaussians"].get<int>(), 1000);
}

TEST(BodyCommands, StudyShowsItsRowsCloseUp) {
  const test::ScratchFolder out;
  const std::string command = "study body " + capture() + " -o " + (out / "study").string() +
                              " --iterations 3 --views 1 --cell 'SH, rotated' --cell 'PBR "
                              "appearance' --cell '4 shadow groups'";
  const Outcome study = run(command);
  ASSERT_EQ(study.code, 0) << study.err;
  EXPECT_TRUE(contains(study.out, "| SH, rotated |")) << study.out;
  const std::string html = read_text(out / "study/report.html");
  EXPECT_TRUE(contains(html, "Close up"));
  EXPECT_TRUE(contains(html, "under lamps, frame"));  // the ball has no ears
  EXPECT_FALSE(contains(html, "ear, frame"));
}

TEST(BodyCommands, BadInputIsOneSentence) {
  expect_sentence("render " + body() + " -o /tmp/x --point-light 1,2,3", "--point-light");
  expect_sentence("render " + body() + " -o /tmp/x --point-light 1,2,3,-1,0,0", "negative");
  expect_sentence("render " + body() + " -o /tmp/x --first 99", "--first");
  expect_sentence("render " + body() + " -o /tmp/x --light nowhere.exr", "nowhere.exr");
  expect_sentence("render " + body() + " -o /tmp/x --drive nowhere", "--drive");
  expect_sentence("render " + body() + " -o /tmp/x --exposure loud", "--exposure");
  expect_sentence("train " + capture() + " -o /tmp/x --set sice=tiny", "unknown setting 'sice'");
  expect_sentence("train " + capture() + " -o /tmp/x --size huge", "size");
  expect_sentence("train " + capture() + " -o /tmp/x --perceptual loud", "--perceptual");
  expect_sentence("train " + capture() + " -o /tmp/x --perceptual vgg --models " + capture(),
                  "vgg16-*.pth");
  expect_sentence(
      "train " + capture() + " -o /tmp/x --set perceptual=squeezenet10 --models " + capture(),
      "squeezenet_v1.0_deep_compression.net");
  expect_sentence("train " + capture() + " -o /tmp/x --set appearance=glass", "appearance");
  expect_sentence("study body " + capture() + " -o /tmp/x --cell nothing", "nothing");
  const test::ScratchFolder out;
  test::write_lit_ball(out / "other", 4, 32);
  Json stage = read_json(out / "other/capture.json");
  stage["keypoints"]["body"] = {"top"};
  std::filesystem::remove(out / "other/tracking.safetensors");
  expect_sentence("train " + (out / "other").string() + " -o /tmp/x", "tracking.safetensors");
}

TEST(BodyCommands, RigsWithoutTextureCoordinatesAreRefused) {
  const test::ScratchFolder out;
  for (const char* name : {"capture", "body"}) {
    std::filesystem::copy(trained() / name, out / name, std::filesystem::copy_options::recursive);
    const Path file = out / name / "rig.safetensors";
    TensorFile rig = read_safetensors(file);
    rig.tensors.erase("uvs");
    rig.tensors.erase("uv_triangles");
    write_safetensors(file, rig);
  }
  const std::string bad = (out / "capture").string(), avatar = (out / "body").string(),
                    to = (out / "to").string();
  for (const std::string& command :
       {"info " + bad, "train " + bad + " -o " + to, "eval " + body() + " " + bad + " -o " + to,
        "info " + avatar, "render " + avatar + " -o " + to, "textures " + avatar + " export " + to})
    expect_sentence(command, "no texture coordinates (UVs)");
  EXPECT_FALSE(std::filesystem::exists(out / "to"));
}

TEST(BodyCommands, InterruptedTrainingGoesOn) {
  const test::ScratchFolder out;
  const std::string command = "train " + capture() + " -o " + (out / "body").string() +
                              " --preset quick --iterations 12 --set checkpoint_every=4 --json";
  ASSERT_EQ(run(command).code, 0);
  // A finished run has no checkpoint to go on from.
  const Outcome again = run(command + " --resume");
  EXPECT_EQ(again.code, 2);
  EXPECT_TRUE(contains(again.err, "checkpoint.safetensors")) << again.err;
}

}  // namespace
}  // namespace effigy
