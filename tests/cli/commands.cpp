// The real command line: results, exit codes and the one sentence of each error.

#include <fstream>

#include "cli/run.h"
#include "effigy/base/json.h"
#include "effigy/base/safetensors.h"
#include "infer/perceptual_files.h"
#include "support.h"
#include "tiny_capture.h"

namespace effigy {
namespace {

using test::contains;
using test::Outcome;
using test::run;
using test::TorchState;

// A small trained avatar and its capture, made once for all tests of this file.
const Path& trained() {
  static const test::ScratchFolder scratch;
  static const bool made = [] {
    test::write_tiny_capture(scratch / "capture");
    const Outcome train =
        run("train " + (scratch / "capture").string() + " -o " + (scratch / "avatar").string() +
            " --preset quick --iterations 30 --surfels 300 --texture-size 64 --consent 'a test' "
            "--set encoder=true --json");
    EXPECT_EQ(train.code, 0) << train.err;
    const Json result = Json::parse(train.out);
    EXPECT_EQ(result["iterations"], 30);
    return true;
  }();
  (void)made;
  return scratch.path();
}

TEST(Commands, HelpAndVersion) {
  EXPECT_EQ(run("--version").code, 0);
  const Outcome help = run("--help");
  EXPECT_EQ(help.code, 0);
  for (const char* name : {"demo", "track", "train", "render", "eval", "textures", "splat", "synth",
                           "import", "study", "info", "bench"}) {
    EXPECT_TRUE(contains(help.out, name)) << name;
    const Outcome one = run(std::string(name) + " --help");
    EXPECT_EQ(one.code, 0) << name << one.err;
    EXPECT_TRUE(contains(one.out, "example:")) << name;
  }
}

TEST(Commands, UsageErrorsAreOneSentenceAndExit2) {
  for (const char* arguments :
       {"nonsense", "train", "train /nonexistent -o /tmp/x", "render /nonexistent -o /tmp/x",
        "eval /nonexistent /nonexistent -o /tmp/x", "textures /nonexistent export /tmp/x",
        "info /nonexistent", "splat /nonexistent -o /tmp/x", "train x -o y --preset fastest",
        "train x -o y --threads 0"}) {
    const Outcome outcome = run(arguments);
    EXPECT_EQ(outcome.code, 2) << arguments << ": " << outcome.err;
    EXPECT_TRUE(outcome.one_sentence()) << arguments << ": " << outcome.err;
    EXPECT_TRUE(outcome.out.empty()) << arguments;
  }
}

TEST(Commands, TrainThenInfoRenderTextures) {
  const Path& place = trained();
  const std::string avatar = (place / "avatar").string();
  const Outcome info = run("info " + avatar + " --json");
  ASSERT_EQ(info.code, 0) << info.err;
  const Json description = Json::parse(info.out);
  EXPECT_EQ(description["what"], "avatar");
  EXPECT_EQ(description["provenance"]["consent"], "a test");

  const std::string frames = (place / "frames").string();
  const Outcome render = run("render " + avatar + " -o " + frames +
                             " --count 2 --light studio --camera orbit --buffers albedo,normal");
  ASSERT_EQ(render.code, 0) << render.err;
  EXPECT_EQ(read_image8(place / "frames/rgb/000001.png").width, 64);
  EXPECT_TRUE(std::filesystem::exists(place / "frames/normal/000000.png"));

  const std::string paint = (place / "paint").string();
  ASSERT_EQ(run("textures " + avatar + " export " + paint).code, 0);
  write_png8(place / "paint/albedo.png", Image8(64, 64, 3, 255));
  ASSERT_EQ(run("textures " + avatar + " apply " + paint).code, 0);
  EXPECT_EQ(read_image8(place / "avatar/textures/albedo.png").at(10, 10)[1], 255);
}

TEST(Commands, ACaptureDrivesThroughTheEncoder) {
  const Path& place = trained();
  const test::ScratchFolder scratch;
  const Path avatar = scratch / "avatar";
  std::filesystem::copy(place / "avatar", avatar, std::filesystem::copy_options::recursive);
  // A held-out frame, which training has not refined: its pose in the avatar's own track is the
  // tracked one, corrected.
  const auto frame = [&](const std::string& drive) {
    const Outcome render = run("render " + avatar.string() + " -o " + (scratch / "out").string() +
                               " --first 7 --count 1 --drive " + drive);
    EXPECT_EQ(render.code, 0) << render.err;
    return read_file(scratch / "out/rgb/000007.png");
  };
  const std::string capture = (place / "capture").string();
  const auto own = frame("train"), driven = frame(capture);
  EXPECT_EQ(own, driven);
  std::filesystem::remove(avatar / "encoder.safetensors");
  EXPECT_NE(frame(capture), own);
  write_text(avatar / "encoder.safetensors", "damaged");
  const Outcome refused = run("info " + avatar.string());
  EXPECT_EQ(refused.code, 2);
  EXPECT_TRUE(refused.one_sentence() && contains(refused.err, "encoder.safetensors"))
      << refused.err;
}

TEST(Commands, SplatDrawsPlyFiles) {
  test::ScratchFolder scratch;
  // A red Gaussian at the origin and a green one to its right, further along z.
  std::string ply =
      "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty "
      "float z\nproperty float opacity\n";
  for (const char* name : {"scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
                           "f_dc_0", "f_dc_1", "f_dc_2"})
    ply += std::string("property float ") + name + "\n";
  ply +=
      "end_header\n0 0 0 9 -2 -2 -2 1 0 0 0 1.77 -1.77 -1.77\n"
      "1 0 2 9 -2 -2 -2 1 0 0 0 -1.77 1.77 -1.77\n";
  write_text(scratch / "two.ply", ply);
  write_text(scratch / "camera.json",
             R"({"width": 40, "height": 30, "fx": 40, "fy": 40, "cx": 20, "cy": 15,
                 "camera_from_world": [[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]})");
  const std::string file = (scratch / "two.ply").string();
  const Outcome drawn = run("splat " + file + " -o " + (scratch / "a.png").string() + " --camera " +
                            (scratch / "camera.json").string());
  ASSERT_EQ(drawn.code, 0) << drawn.err;
  const Image8 image = read_image8(scratch / "a.png");
  ASSERT_EQ(image.width, 40);
  EXPECT_GT(image.at(19, 14)[0], 220);
  EXPECT_LT(image.at(19, 14)[1], 30);
  EXPECT_GT(image.at(26, 14)[1], 220);  // x / z = 1 / 6
  EXPECT_EQ(image.at(2, 2)[0], 0);
  // Circling: y is down in the file, so half a turn shows the green one on the left.
  for (const auto& [turn, right] : {std::pair{0, true}, std::pair{180, false}}) {
    const Outcome circled = run("splat " + file + " -o " + (scratch / "b.png").string() +
                                " --size 41,31 --turn " + std::to_string(turn));
    ASSERT_EQ(circled.code, 0) << circled.err;
    const Image8 view = read_image8(scratch / "b.png");
    double sum = 0, weight = 0;
    for (int y = 0; y < 31; ++y)
      for (int x = 0; x < 41; ++x) {
        sum += x * view.at(x, y)[1];
        weight += view.at(x, y)[1];
      }
    ASSERT_GT(weight, 0);
    double red = 0, red_weight = 0;
    for (int y = 0; y < 31; ++y)
      for (int x = 0; x < 41; ++x) {
        red += x * view.at(x, y)[0];
        red_weight += view.at(x, y)[0];
      }
    EXPECT_EQ(sum / weight > red / red_weight, right) << turn;
  }
  EXPECT_EQ(run("info " + file).code, 0);
  for (const std::string& bad :
       {"splat " + file + " -o " + (scratch / "c.jpg").string(),
        "splat " + file + " -o x.png --gradients", "splat " + file + " -o x.png --up w",
        "splat " + file + " -o x.png --size 0,4", std::string("splat /nonexistent.ply -o x.png")}) {
    const Outcome outcome = run(bad);
    EXPECT_EQ(outcome.code, 2) << bad << outcome.err;
    EXPECT_TRUE(outcome.one_sentence()) << outcome.err;
  }
}

TEST(Commands, ShardsTogetherAreTheWhole) {
  const Path& place = trained();
  const std::string avatar = (place / "avatar").string();
  ASSERT_EQ(run("render " + avatar + " -o " + (place / "whole").string()).code, 0);
  for (int i = 0; i < 2; ++i)
    ASSERT_EQ(run("render " + avatar + " -o " + (place / "parts").string() + " --shard " +
                  std::to_string(i) + "/2")
                  .code,
              0);
  for (int f = 0; f < 8; ++f) {
    const std::string name = "rgb/00000" + std::to_string(f) + ".png";
    EXPECT_EQ(read_file(place / "whole" / name), read_file(place / "parts" / name));
  }
  EXPECT_EQ(run("render " + avatar + " -o /tmp/x --shard 2/2").code, 2);
}

TEST(Commands, ShardsOfEvalMergeToTheWhole) {
  const Path& place = trained();
  const test::ScratchFolder out;
  const std::string command = "eval " + (place / "avatar").string() + " " +
                              (place / "capture").string() + " --refine-steps 2 --lpips none -o ";
  ASSERT_EQ(run(command + (out / "whole").string()).code, 0);
  for (const char* shard : {"0/2", "1/2"}) {
    const Outcome part = run(command + (out / "parts").string() + " --shard " + shard);
    ASSERT_EQ(part.code, 0) << part.err;
  }
  const Outcome merge = run(command + (out / "parts").string() + " --merge");
  ASSERT_EQ(merge.code, 0) << merge.err;
  Json whole = read_json(out / "whole/metrics.json"),
       merged = read_json(out / "parts/metrics.json");
  EXPECT_TRUE(merged.contains("refined"));
  EXPECT_EQ(merged["protocol"], "tracked");
  EXPECT_NE(merged["psnr"], merged["tracker"]["psnr"]);  // the encoder's correction
  whole.erase("seconds");
  merged.erase("seconds");
  EXPECT_EQ(whole, merged);
  EXPECT_TRUE(std::filesystem::exists(out / "parts/report.html"));
}

TEST(Commands, BadAvatarInputsAreNamed) {
  const Path& place = trained();
  test::ScratchFolder scratch;
  std::filesystem::copy(place / "avatar", scratch / "avatar",
                        std::filesystem::copy_options::recursive);
  const std::string avatar = (scratch / "avatar").string();
  const auto fails = [&](const std::string& arguments, const std::string& part) {
    const Outcome outcome = run(arguments);
    EXPECT_EQ(outcome.code, 2) << outcome.err;
    EXPECT_TRUE(outcome.one_sentence() && contains(outcome.err, part)) << outcome.err;
  };
  fails("render " + avatar + " -o /tmp/x --light /nonexistent.hdr", "nonexistent.hdr");
  fails("render " + avatar + " -o /tmp/x --drive nobody", "nobody");
  fails("render " + avatar + " -o /tmp/x --camera 1,2,3", "--camera");
  fails("render " + avatar + " -o /tmp/x --buffers beauty", "beauty");
  const auto before = read_file(scratch / "avatar/textures/albedo.png");
  std::filesystem::create_directories(scratch / "edit");
  write_png8(scratch / "edit/albedo.png", Image8(30, 20, 3));
  fails("textures " + avatar + " apply " + (scratch / "edit").string(), "30x20");
  EXPECT_EQ(read_file(scratch / "avatar/textures/albedo.png"), before);
  write_text(scratch / "avatar/textures/normal.png", "not a picture");
  fails("render " + avatar + " -o /tmp/x", "normal.png");
}

// A rig without UVs, or with damaged ones, in a capture or an avatar: the same sentence everywhere.
TEST(Commands, RigsWithoutTextureCoordinatesAreRefused) {
  test::ScratchFolder scratch;
  std::filesystem::copy(trained() / "capture", scratch / "capture",
                        std::filesystem::copy_options::recursive);
  std::filesystem::copy(trained() / "avatar", scratch / "avatar",
                        std::filesystem::copy_options::recursive);
  const std::string capture = (scratch / "capture").string(),
                    avatar = (scratch / "avatar").string(), sound = (trained() / "avatar").string(),
                    out = (scratch / "out").string();
  const TensorFile good = read_safetensors(scratch / "capture/rig.safetensors");
  for (const bool damaged : {false, true}) {
    TensorFile bad = good;
    if (damaged) {
      std::vector<int32_t> corners = good.ints("uv_triangles", {-1, 3});
      corners[4] = 1 << 28;
      bad.tensors["uv_triangles"] =
          Tensor::from(std::span<const int32_t>(corners), good.shape("uv_triangles"));
    } else {
      bad.tensors.erase("uvs");
      bad.tensors.erase("uv_triangles");
    }
    for (const Path& folder : {scratch / "capture", scratch / "avatar"})
      write_safetensors(folder / "rig.safetensors", bad);
    for (const std::string& command :
         {"info " + capture, "train " + capture + " -o " + out + " --iterations 2",
          "eval " + sound + " " + capture + " -o " + out, "info " + avatar,
          "render " + avatar + " -o " + out, "eval " + avatar + " " + capture + " -o " + out,
          "textures " + avatar + " export " + out}) {
      const Outcome outcome = run(command);
      EXPECT_EQ(outcome.code, 2) << command << outcome.err;
      EXPECT_TRUE(outcome.one_sentence()) << command << outcome.err;
      EXPECT_TRUE(contains(outcome.err, damaged ? "UV triangle 1 has index 268435456"
                                                : "no texture coordinates (UVs)"))
          << command << outcome.err;
      EXPECT_FALSE(std::filesystem::exists(out)) << command;
    }
  }
}

TEST(Commands, StudyScoresItsCellsOnce) {
  const test::ScratchFolder scratch;
  const std::string capture = (scratch / "capture").string(), out = (scratch / "study").string();
  ASSERT_EQ(run("synth head -o " + capture +
                " --frames 5 --size 40 --spp 1 --texture-size 64 --relight window")
                .code,
            0);
  const std::string study = "study relight " + capture + " -o " + out +
                            " --iterations 12 --surfels 200 --texture-size 64 --frames 1 --json";
  const std::string cells = " --cell 'without mask loss' --cell 'without start light'";
  const Outcome first = run(study + cells);
  ASSERT_EQ(first.code, 0) << first.err;
  const Json table = Json::parse(first.out)["cells"];
  ASSERT_EQ(table.size(), 3u);
  EXPECT_EQ(table[0]["name"], "all");
  EXPECT_EQ(table[1]["changes"], Json({{"weight.mask", 0.0}}));
  for (const Json& cell : table) {
    EXPECT_GT(cell["metrics"]["relight"]["window"]["psnr_aligned"].get<double>(), 3.0);
    EXPECT_GT(cell["metrics"]["psnr"].get<double>(), 3.0);
  }
  EXPECT_TRUE(contains(read_text(scratch / "study" / "report.html"), "without start light"));

  // What was scored is not trained again: a mark in a cell's record comes back.
  const Path record = scratch / "study" / "cells" / "without-mask-loss" / "cell.json";
  Json marked = read_json(record);
  marked["metrics"]["psnr"] = 123.0;
  write_json(record, marked);
  EXPECT_EQ(Json::parse(run(study + cells).out)["cells"][1]["metrics"]["psnr"], 123.0);

  for (const std::string& wrong :
       {std::string("study relight"), "study relight " + capture,
        std::string("study relight /nonexistent -o x"), study + " --cell nonsense",
        std::string("study body " + capture + " -o x")}) {
    const Outcome outcome = run(wrong);
    EXPECT_EQ(outcome.code, 2) << wrong << outcome.err;
    EXPECT_TRUE(outcome.one_sentence()) << wrong << outcome.err;
  }
}

TEST(Commands, WriteFailuresExit1AndKeepWhatWasThere) {
  const Path& place = trained();
  test::ScratchFolder scratch;
  write_text(scratch / "file", "keep me");
  const Outcome outcome = run("train " + (place / "capture").string() + " -o " +
                              (scratch / "file").string() + " --preset quick --iterations 1");
  EXPECT_NE(outcome.code, 0);
  EXPECT_TRUE(contains(outcome.err, "in the way")) << outcome.err;
  EXPECT_EQ(read_text(scratch / "file"), "keep me");
  const Outcome full =
      run("render " + (place / "avatar").string() + " -o /proc/effigy-frames --count 1");
  EXPECT_EQ(full.code, 1) << full.err;
}

TEST(Commands, InterruptedTrainingResumes) {
  const Path& place = trained();
  test::ScratchFolder scratch;
  const std::string common = "train " + (place / "capture").string() + " -o " +
                             (scratch / "avatar").string() +
                             " --preset quick --iterations 1200 --surfels 300 --texture-size 64"
                             " --set checkpoint_every=10 --set evaluate_every=0";
  const std::string program = EFFIGY_BINARY_DIR "/bin/effigy ";
  const int status = std::system(
      ("timeout -s INT 2 " + program + common + " 2>" + (scratch / "err").string()).c_str());
  if (WEXITSTATUS(status) == 0) GTEST_SKIP() << "the run ended before it could be interrupted";
  ASSERT_TRUE(std::filesystem::exists(scratch / "avatar/checkpoint.safetensors"))
      << read_text(scratch / "err");
  EXPECT_TRUE(contains(read_text(scratch / "err"), "--resume"));
  EXPECT_EQ(run(common + " --resume").code, 0);
  EXPECT_TRUE(std::filesystem::exists(scratch / "avatar/avatar.json"));
}

// Distances that need networks: measured where their files are, said to be left out elsewhere.
TEST(Commands, EvalMeasuresPerceptualDistances) {
  if (!std::filesystem::exists(EFFIGY_BINARY_DIR "/bin/effigy-learn"))
    GTEST_SKIP() << "effigy-learn is not built";
  const Path& place = trained();
  test::ScratchFolder scratch;
  const Path models = scratch / "models";
  std::filesystem::create_directories(models / "perceptual");
  const std::string command = "eval " + (place / "avatar").string() + " " +
                              (place / "capture").string() + " -o " + (scratch / "eval").string() +
                              " --frames 1 --refine-steps 1 --light studio --json --models " +
                              models.string();
  const auto report = [&] { return read_text(scratch / "eval/report.html"); };

  const Outcome without = run(command);
  ASSERT_EQ(without.code, 0) << without.err;
  const Json none = Json::parse(without.out);
  for (const char* name : {"lpips", "lpips_net", "feature_squeezenet10"})
    EXPECT_TRUE(none.contains(name) && none[name].is_null()) << name;
  EXPECT_FALSE(none.contains("lpips_unit_range"));
  EXPECT_TRUE(contains(none["lpips_note"], "left out: no backbone weights"));
  EXPECT_TRUE(contains(report(), "LPIPS is left out: no backbone weights"));

  // Heads alone, which are easily had, are not LPIPS.
  test::write_torch(test::random_heads(test::head_channels("squeeze"), 1), models / "squeeze.pth");
  const Json heads = Json::parse(run(command).out);
  EXPECT_TRUE(heads["lpips"].is_null());
  EXPECT_TRUE(contains(heads["lpips_note"], "squeezenet1_1-*.pth is not there"));
  const Outcome asked = run(command + " --lpips vgg");
  EXPECT_EQ(asked.code, 2);
  EXPECT_TRUE(asked.one_sentence() && contains(asked.err, "vgg16-*.pth")) << asked.err;
  EXPECT_EQ(run(command + " --lpips-backbone x.pth").code, 2);

  const Path backbone = models / "perceptual/squeezenet1_1-00000000.pth";
  test::write_torch(test::random_backbone(test::squeeze_layers(), 2), backbone);
  TorchState squeezenet10 = test::random_backbone(test::squeeze10_layers(), 3);
  write_text(models / "compressed_SqueezeNet.net", test::deep_compressed(squeezenet10, 4));
  const Outcome with = run(command);
  ASSERT_EQ(with.code, 0) << with.err;
  const Json all = Json::parse(with.out);
  for (const Json& scores : {all, all["tracker"], all["refined"]}) {
    EXPECT_EQ(scores["lpips_net"], "squeeze");
    for (const char* name : {"lpips", "lpips_unit_range", "feature_squeezenet10"}) {
      ASSERT_TRUE(scores[name].is_number()) << name;
      EXPECT_GT(scores[name].get<double>(), 0) << name;
      EXPECT_EQ(scores[name], scores["per_frame"][0][name]) << name;
    }
  }
  EXPECT_FALSE(all.contains("lpips_note"));
  EXPECT_EQ(all["psnr"], none["psnr"]);  // the other executable, the same scores
  EXPECT_EQ(all, read_json(scratch / "eval/metrics.json"));
  EXPECT_TRUE(contains(report(), "LPIPS (squeeze)") && !contains(report(), "left out"));

  const Json off = Json::parse(run(command + " --lpips none").out);
  EXPECT_TRUE(off["lpips"].is_null() && off["feature_squeezenet10"].is_number());
  // A file of another network is found out and named.
  const Outcome wrong = run(command + " --lpips squeeze --lpips-heads " + backbone.string());
  EXPECT_EQ(wrong.code, 2);
  EXPECT_TRUE(wrong.one_sentence() && contains(wrong.err, backbone.string()) &&
              contains(wrong.err, "this is a backbone"))
      << wrong.err;
}

}  // namespace
}  // namespace effigy
