// The commands that make captures, synth and import: results, exit codes and the one sentence of
// each error.

#include <cmath>

#include "cli/run.h"
#include "effigy/base/json.h"
#include "support.h"
#include "tiny_capture.h"

namespace effigy {
namespace {

using test::contains;
using test::Outcome;
using test::run;

TEST(CaptureCommands, SynthMakesACaptureThatInfoFindsSound) {
  test::ScratchFolder scratch;
  const std::string capture = (scratch / "capture").string();
  const Outcome made = run("synth head -o " + capture +
                           " --frames 4 --size 48 --spp 2 --texture-size 128 --relight window "
                           "--relight-frames 1 --noise 0.01 --compression 80 --json");
  ASSERT_EQ(made.code, 0) << made.err;
  EXPECT_EQ(Json::parse(made.out)["images"], 5);
  EXPECT_EQ(run("info " + capture).code, 0);
  const Outcome noise =
      run("synth head -o x --frames 4 --size 48 --spp 2 --measure-noise 4 --json");
  ASSERT_EQ(noise.code, 0) << noise.err;
  const Json measured = Json::parse(noise.out);
  EXPECT_GT(measured["psnr"].get<double>(), 15);
  EXPECT_EQ(measured["lights"].size(), 4u);
  for (const auto& [light, figures] : measured["lights"].items()) {
    EXPECT_LE(figures["psnr_least"], figures["psnr"]) << light;
    EXPECT_LT(figures["psnr_foreground"], figures["psnr"]) << light;
  }
}

TEST(CaptureCommands, SynthBodyMakesAStageThatInfoFindsSound) {
  test::ScratchFolder scratch;
  const std::string capture = (scratch / "stage").string();
  const Outcome made = run("synth body -o " + capture +
                           " --cameras 2 --lights 12 --frames 2 --size 48 --spp 1 --bounces 1 "
                           "--texture-size 128 --json");
  ASSERT_EQ(made.code, 0) << made.err;
  EXPECT_EQ(Json::parse(made.out)["images"], 4);
  const Outcome info = run("info --json " + capture);
  ASSERT_EQ(info.code, 0) << info.err;
  const Json found = Json::parse(info.out);
  EXPECT_EQ(found["kind"], "body");
  EXPECT_EQ(found["test_cameras"], 1);
  EXPECT_EQ(found["test_motion"], 1);
}

TEST(CaptureCommands, ImportMakesAStageThatInfoFindsSound) {
  const test::ScratchFolder scratch;
  write_obj(scratch / "scene.obj", test::ball_rig().mesh);
  Json frames = Json::array();
  for (int k = 0; k < 3; ++k) {
    const std::string name = "r_" + std::to_string(k);
    write_png8(scratch / (name + ".png"), Image8(16, 16, 4, 200));
    frames.push_back({{"file_path", name},
                      {"transform_matrix", {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 2}}},
                      {"pl_pos", {k, 1, 1}}});
  }
  write_json(scratch / "transforms.json", {{"camera_angle_x", 0.4}, {"frames", frames}});
  const std::string source = scratch.path().string(), capture = (scratch / "out").string(),
                    mesh = (scratch / "scene.obj").string();
  const Outcome made =
      run("import transforms " + source + " -o " + capture + " --mesh " + mesh + " --json");
  ASSERT_EQ(made.code, 0) << made.err;
  EXPECT_EQ(Json::parse(made.out)["views"], 3);
  EXPECT_EQ(run("info " + capture).code, 0);
  for (const std::string& bad :
       {"goliath " + source + " -o x", "transforms " + source + " -o x",
        "transforms /nowhere -o x --mesh " + mesh, "insta " + source + " -o x",
        "transforms " + source + " -o x --scale 2 --mesh " + mesh,
        "transforms " + source + " -o x --cameras camera7 --mesh " + mesh}) {
    const Outcome outcome = run("import " + bad);
    EXPECT_EQ(outcome.code, 2) << bad;
    EXPECT_TRUE(outcome.one_sentence()) << outcome.err;
  }
  // A folder that is not one of ours stays as it is.
  write_text(scratch / "mine/notes.txt", "keep");
  EXPECT_EQ(
      run("import transforms " + source + " -o " + (scratch / "mine").string() + " --mesh " + mesh)
          .code,
      1);
  EXPECT_EQ(read_text(scratch / "mine/notes.txt"), "keep");
}

TEST(CaptureCommands, SynthBodyRefusesBadInputInOneSentence) {
  test::ScratchFolder scratch;
  const auto fails = [&](const std::string& arguments, const std::string& part) {
    const Outcome outcome = run("synth body --texture-size 64 --spp 1 --no-layers -o " +
                                (scratch / "x").string() + " --frames 2 --size 32 " + arguments);
    EXPECT_EQ(outcome.code, 2) << arguments << ": " << outcome.err;
    EXPECT_TRUE(outcome.one_sentence() && contains(outcome.err, part)) << outcome.err;
    EXPECT_FALSE(std::filesystem::exists(scratch / "x"));
    EXPECT_FALSE(std::filesystem::exists(scratch / "x.partial"));
  };
  fails("--lights 0", "at least one light");
  fails("--lights -1", "at least one light");
  for (const char* wrong : {"--cameras 0",
                            "--cameras -1",
                            "--radius nan",
                            "--radius 0",
                            "--radius -1",
                            "--frames -1",
                            "--frames 0",
                            "--fps -1",
                            "--fps 0",
                            "--size 0",
                            "--size -1",
                            "--size 64 -1",
                            "--spp 0",
                            "--spp -4",
                            "--bounces 0",
                            "--texture-size 0",
                            "--texture-size -1",
                            "--subject -1",
                            "--relight-frames 0",
                            "--relight-frames -1",
                            "--unseen-frames -1",
                            "--unseen-frames 2",
                            "--tracking-error -1"}) {
    const std::string option = wrong;
    fails(option, option.substr(0, option.find(' ')));
  }
  // Some cameras are in the body, others are not.
  fails("--radius 0.2 --cameras 12", "camera cam003");
  fails("--body " + (scratch / "none.glb").string(), "none.glb");
  fails("--stage huge", "huge");
  fails("--lighting dark", "dark");
  write_text(scratch / "broken.hdr", "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\nxx");
  fails("--lighting environment --light " + (scratch / "broken.hdr").string(), "broken.hdr");
  write_text(scratch / "none.txt", "# nothing\n");
  fails("--light-positions " + (scratch / "none.txt").string(), "none.txt");
  write_text(scratch / "nan.bvh",
             "HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\nCHANNELS 3 Xrotation Yrotation Zrotation\n"
             "End Site\n{\nOFFSET 0 1 0\n}\n}\nMOTION\nFrames: 1\nFrame Time: 0.03\nnan 0 0\n");
  fails("--motion " + (scratch / "nan.bvh").string(), "nan.bvh");
}

TEST(CaptureCommands, SynthRefusesBadInputInOneSentence) {
  test::ScratchFolder scratch;
  const auto fails = [&](const std::string& arguments, const std::string& part) {
    const Outcome outcome = run("synth " + arguments);
    EXPECT_EQ(outcome.code, 2) << arguments << ": " << outcome.err;
    EXPECT_TRUE(outcome.one_sentence() && contains(outcome.err, part)) << outcome.err;
  };
  const std::string head = "head -o " + (scratch / "x").string() + " --frames 4 --size 32 --spp 1 ";
  write_text(scratch / "broken.hdr", "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\nxx");
  fails(head + "--light " + (scratch / "broken.hdr").string(), "broken.hdr");
  write_exr(scratch / "black.exr", Image(8, 4, 3, 0.0f));
  fails(head + "--light " + (scratch / "black.exr").string(), "black everywhere");
  Image bad(8, 4, 3, 1.0f);
  bad.data[5] = std::nanf("");
  write_exr(scratch / "nan.exr", bad, false);
  fails(head + "--relight " + (scratch / "nan.exr").string(), "not finite");
  fails(head + "--light moon", "moon");
  fails(head + "--distance 0.01", "camera is inside");
  for (const char* wrong : {"--size -1",
                            "--size 0",
                            "--fps 0",
                            "--fps -1",
                            "--spp 0",
                            "--spp -1",
                            "--bounces 0",
                            "--bounces -1",
                            "--texture-size 0",
                            "--texture-size -1",
                            "--distance 0",
                            "--distance -1",
                            "--subject -1",
                            "--relight-frames 0",
                            "--relight-frames -1",
                            "--noise -1",
                            "--compression -1",
                            "--compression 101",
                            "--tracking-error -1",
                            "--measure-noise 0",
                            "--measure-noise -2"}) {
    const std::string option = wrong;
    fails("head -o " + (scratch / "x").string() + " " + option, option.substr(0, option.find(' ')));
  }
  fails("head --frames 0 -o " + (scratch / "x").string(), "--frames");
  fails("head --frames -3 -o " + (scratch / "x").string(), "--frames");
  fails("head --head me.glb --subject 2 -o " + (scratch / "x").string(), "--subject");
  fails(head + "--head " + (scratch / "me.glb").string(), "me.glb");
  fails("scene x.json -o x.exr --spp 0", "--spp");
  fails(head + "--truth guess", "guess");
  fails("", "subcommand");
  EXPECT_FALSE(std::filesystem::exists(scratch / "x"));
  // Described scenes.
  const auto scene = [&](const Json& change) {
    Json json = {
        {"camera",
         {{"eye", {0, 0, 3}}, {"target", {0, 0, 0}}, {"fov_y", 40}, {"width", 8}, {"height", 8}}},
        {"materials", {{"m", Json::object()}}},
        {"meshes", {{{"file", "plate.obj"}, {"material", "m"}}}},
        {"point_lights", {{{"position", {0, 0, 3}}, {"intensity", {9, 9, 9}}}}},
        {"samples", 4}};
    if (change.is_object()) json.merge_patch(change);
    write_json(scratch / "scene.json", json);
    return "scene " + (scratch / "scene.json").string() + " -o " + (scratch / "a.exr").string();
  };
  write_text(scratch / "plate.obj", "v -1 -1 0\nv 1 -1 0\nv 0 1 0\nf 1 2 3\n");
  EXPECT_EQ(run("synth " + scene({})).code, 0);
  fails(scene({{"point_lights", Json::array()}}), "no light");
  write_png8(scratch / "skin.png", Image8(4, 4, 3, 99));
  fails(scene({{"materials", {{"m", {{"albedo", "skin.png"}}}}}}), "UVs");
  fails(scene({{"meshes", {{{"file", "plate.obj"}, {"material", "silk"}}}}}), "silk");
  fails(scene({{"camera", {{"fov_y", 0}}}}), "fov_y");
  write_text(scratch / "plate.obj", "v -1 -1 nan\nv 1 -1 0\nv 0 1 0\nf 1 2 3\n");
  fails(scene({}), "plate.obj");
  std::string box;
  for (int i = 0; i < 8; ++i)
    box += "v " + std::to_string(i & 1 ? 9 : -9) + " " + std::to_string(i & 2 ? 9 : -9) + " " +
           std::to_string(i & 4 ? 9 : -9) + "\n";
  write_text(scratch / "plate.obj",
             box + "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n");
  fails(scene({}), "inside a mesh");
}

}  // namespace
}  // namespace effigy
