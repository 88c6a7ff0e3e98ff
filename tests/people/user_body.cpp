// The user's own bodies: files with known answers, hostile files, and real ones where they are.

#include "effigy/people/user_body.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>

#include "effigy/base/error.h"
#include "effigy/geometry/atlas.h"
#include "tiny_gltf.h"

namespace effigy {
namespace {

using test::sound_gltf;

class Folder {
 public:
  Folder()
      : path_(std::filesystem::temp_directory_path() /
              ("effigy_user_" + std::to_string(::getpid()))) {
    make_folder(path_);
  }
  ~Folder() { std::filesystem::remove_all(path_); }
  Path write(const std::string& name, const std::string& text) const {
    write_text(path_ / name, text);
    return path_ / name;
  }

 private:
  Path path_;
};

std::string error_of(const std::string& text) {
  const Folder folder;
  const Path path = folder.write("body.gltf", text);
  try {
    read_gltf_body(path, 64);
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("body.gltf"), std::string::npos) << error.what();
    return error.what();
  }
  return "";
}

std::string with(const std::string& from, const std::string& to) {
  std::string text = sound_gltf();
  const size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return error_of(text.replace(at, from.size(), to));
}

TEST(Gltf, ReadsRestPoseJointsWeightsAndColours) {
  const Folder folder;
  const UserBody body = read_gltf_body(folder.write("body.gltf", sound_gltf()), 64);
  ASSERT_EQ(body.rig.mesh.vertex_count(), 4);
  EXPECT_EQ(body.rig.joint_names, (std::vector<std::string>{"base", "tip"}));
  EXPECT_EQ(body.rig.parents, (std::vector<int>{-1, 0}));
  // Without inverse bind matrices the first joint of the skin, "tip", adds its own place.
  EXPECT_NEAR(body.rig.mesh.vertex(0).x(), 0.5, 1e-6);
  EXPECT_NEAR(body.rig.mesh.vertex(1).x(), 1.0, 1e-6);
  EXPECT_EQ(body.rig.weights[1], 1);  // vertex 0 follows "tip"
  const RigShape shape = shape_rig(body.rig, {});
  EXPECT_NEAR(shape.joints[3], 0.5, 1e-5);
  EXPECT_EQ(inspect_atlas(body.rig.mesh, 64).overlaps, 0);
  EXPECT_NEAR(body.albedo.at(32, 32)[0], 0.8, 1e-5);
  EXPECT_NEAR(body.roughness.at(32, 32)[0], 0.4, 1e-5);
}

TEST(Gltf, RefusesBrokenFilesInOneSentence) {
  EXPECT_EQ(error_of(sound_gltf()), "");
  EXPECT_NE(with(",\"TEXCOORD_0\":1", "").find("no UVs"), std::string::npos);
  EXPECT_NE(with("\"mesh\":0,\"skin\":0", "\"mesh\":0").find("no skin"), std::string::npos);
  EXPECT_NE(with("\"joints\":[2,1]", "\"joints\":[2,77]"), "");
  EXPECT_NE(with("\"joints\":[2,1]", "\"joints\":[2]").find("joint"), std::string::npos);
  EXPECT_NE(with("\"count\":4,\"type\":\"VEC3\"", "\"count\":400,\"type\":\"VEC3\""), "");
  EXPECT_NE(with("\"count\":4,\"type\":\"VEC3\"", "\"count\":4000000000,\"type\":\"VEC3\""), "");
  EXPECT_NE(with("\"byteOffset\":160", "\"byteOffset\":96").find("index"), std::string::npos);
  EXPECT_NE(with("\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\"",
                 "\"bufferView\":9,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\""),
            "");
  EXPECT_NE(with("\"children\":[2]", "\"children\":[1]"), "");
  EXPECT_NE(with("\"material\":0", "\"material\":12"), "");
  EXPECT_NE(with("\"asset\"", "asset"), "");
  EXPECT_NE(error_of(""), "");
  EXPECT_NE(error_of("glTF\x02"), "");
}

TEST(Gltf, ReadsAClothedPerson) {
  const char* data = std::getenv("EFFIGY_DATA");
  const Path path = Path(data ? data : "") / "body/morse_human/morse_makehuman_human.glb";
  if (!data || !std::filesystem::exists(path)) GTEST_SKIP() << "needs EFFIGY_DATA/body/morse_human";
  const UserBody body = read_gltf_body(path, 256);
  // The file's skin has 77 joints with two roots; a rig has one.
  EXPECT_EQ(body.rig.joint_count(), 78);
  EXPECT_GT(body.rig.mesh.triangle_count(), 5000);
  float low = 9, high = -9;
  for (int v = 0; v < body.rig.mesh.vertex_count(); ++v) {
    low = std::min(low, body.rig.mesh.vertex(v).y());
    high = std::max(high, body.rig.mesh.vertex(v).y());
  }
  EXPECT_GT(high - low, 1.5);
  EXPECT_LT(high - low, 2.1);
}

TEST(MakeHuman, ReadsTheBase) {
  const char* data = std::getenv("EFFIGY_DATA");
  const Path folder = Path(data ? data : "") / "body/makehuman";
  if (!data || !std::filesystem::exists(folder / "3dobjs/base.obj"))
    GTEST_SKIP() << "needs EFFIGY_DATA/body/makehuman";
  const UserBody body =
      read_makehuman_body(folder, folder / "young_lightskinned_male_diffuse.png", 256);
  EXPECT_EQ(body.rig.mesh.vertex_count(), 13380);
  EXPECT_EQ(body.rig.joint_count(), 163);
  EXPECT_EQ(inspect_atlas(body.rig.mesh, 512).overlaps, 0);
  EXPECT_THROW(read_makehuman_body(folder / "rigs"), Error);
}

}  // namespace
}  // namespace effigy
