// effigy info: what a file or folder is, and whether it is sound.

#include <cstdio>

#include "effigy/avatar/head_avatar.h"
#include "effigy/avatar/kind.h"
#include "effigy/avatar/textures.h"
#include "effigy/base/log.h"
#include "effigy/base/safetensors.h"
#include "effigy/capture/stage_capture.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"
#include "effigy/geometry/ply.h"
#include "effigy/image/files.h"
#include "effigy/image/video.h"
#include "effigy/rig/rig_file.h"
#include "effigy/splat/gaussian_ply.h"

namespace effigy {
namespace {

Json describe_stage(const Path& path) {
  const StageCapture capture = read_stage_capture(path);
  for (size_t f = 0; f < capture.frames.size(); ++f) {
    load_frame_arrays(capture, static_cast<int>(f));
    for (size_t c = 0; c < capture.cameras.size(); ++c) {
      capture.load_image(static_cast<int>(c), static_cast<int>(f));
      capture.load_mask(static_cast<int>(c), static_cast<int>(f));
    }
  }
  return {{"what", "capture"},
          {"kind", "body"},
          {"rig", capture.rig.kind},
          {"cameras", capture.cameras.size()},
          {"test_cameras", capture.test_cameras().size()},
          {"lights", capture.lights.size()},
          {"frames", capture.frames.size()},
          {"train", capture.frames_of(StageSplit::kTrain).size()},
          {"test_lights", capture.frames_of(StageSplit::kLights).size()},
          {"test_motion", capture.frames_of(StageSplit::kMotion).size()},
          {"test_environment", capture.frames_of(StageSplit::kEnvironment).size()},
          {"size", {capture.cameras[0].camera.width, capture.cameras[0].camera.height}},
          {"layers", capture.layers},
          {"source", capture.source},
          {"licence", capture.licence},
          {"consent", capture.consent}};
}

Json describe_capture(const Path& path) {
  if (capture_kind(path) == "body") return describe_stage(path);
  const Capture capture = read_capture(path);
  for (size_t f = 0; f < capture.frames.size(); ++f) {
    capture.load_image(static_cast<int>(f));
    capture.load_mask(static_cast<int>(f));
  }
  return {{"what", "capture"},
          {"kind", "head"},
          {"rig", capture.rig.kind},
          {"frames", capture.frames.size()},
          {"train", capture.train_frames().size()},
          {"test", capture.test_frames().size()},
          {"size", {capture.camera.width, capture.camera.height}},
          {"source", capture.source},
          {"licence", capture.licence},
          {"consent", capture.consent}};
}

// Everything but the networks' meaning, which effigy-learn checks when it uses them.
Json describe_body(const Path& path) {
  const Json info = read_avatar_json(path);
  const Rig rig = read_rig(path / "rig.safetensors");
  const TensorFile networks = read_safetensors(path / "networks.safetensors");
  const MaterialImages maps = read_maps(path / "textures");
  Json tracks = Json::object();
  if (std::filesystem::is_directory(path / "tracks"))
    for (const auto& entry : std::filesystem::directory_iterator(path / "tracks"))
      if (entry.path().extension() == ".safetensors")
        tracks[entry.path().stem().string()] = read_track(entry.path(), rig).poses.size();
  int64_t parameters = 0;
  for (const auto& [name, tensor] : networks.tensors) {
    int64_t count = 1;
    for (const int64_t extent : tensor.shape) count *= extent;
    parameters += count;
  }
  return {{"what", "avatar"},
          {"kind", "body"},
          {"rig", rig.kind},
          {"rig_licence", rig.licence},
          {"gaussians", info.value("gaussians", 0)},
          {"parameters", parameters},
          {"texture", {maps.albedo.width, maps.albedo.height}},
          {"tracks", tracks},
          {"provenance", info.value("provenance", Json::object())}};
}

Json describe_avatar(const Path& path) {
  if (avatar_kind(path) == "body") return describe_body(path);
  const HeadAvatar avatar = read_head_avatar(path);
  Json tracks = Json::object();
  for (const auto& [name, track] : avatar.tracks) tracks[name] = track.poses.size();
  return {{"what", "avatar"},
          {"kind", "head"},
          {"rig", avatar.rig.kind},
          {"rig_licence", avatar.rig.licence},
          {"surfels", avatar.surfels.count()},
          {"texture", {avatar.material.width, avatar.material.height}},
          {"tracks", tracks},
          {"provenance", avatar.info.value("provenance", Json::object())},
          {"metrics", avatar.info.value("metrics", Json::object())}};
}

Json describe_rig(const Rig& rig) {
  return {{"what", "rig"},
          {"kind", rig.kind},
          {"licence", rig.licence},
          {"vertices", rig.mesh.vertex_count()},
          {"triangles", rig.mesh.triangle_count()},
          {"identity", rig.identity_count},
          {"expressions", rig.expression_count},
          {"joints", rig.joint_names},
          {"mediapipe_landmarks", rig.mediapipe.size()}};
}

Json describe_image(const Path& path) {
  const Image image = read_image(path);
  return {{"what", "image"}, {"size", {image.width, image.height}}, {"channels", image.channels}};
}

Json describe_video(const Path& path) {
  VideoReader reader(path);
  Image8 frame;
  int64_t frames = 0;
  while (reader.next(frame)) ++frames;
  return {{"what", "video"},
          {"size", {reader.info().width, reader.info().height}},
          {"frames", frames},
          {"frames_per_second", reader.info().frames_per_second},
          {"codec", reader.info().codec},
          {"pixel_format", reader.info().pixel_format}};
}

Json describe_tensors(const Path& path) {
  const TensorFile file = read_safetensors(path);
  if (file.metadata.count("format") && file.metadata.at("format") == "effigy-rig")
    return describe_rig(read_rig(path));
  Json tensors = Json::object();
  for (const auto& [name, tensor] : file.tensors) tensors[name] = tensor.shape;
  return {{"what", "safetensors"}, {"metadata", file.metadata}, {"tensors", tensors}};
}

// 3D Gaussians, or the vertices of another PLY file.
Json describe_ply(const Path& path) {
  const PlyVertices table = read_ply_vertices(path);
  if (table.find("scale_0") < 0 || table.find("opacity") < 0)
    return {{"what", "ply"}, {"vertices", table.count()}, {"columns", table.columns}};
  const GaussianModel model = read_gaussian_ply(path);
  return {{"what", "gaussians"},
          {"gaussians", model.count()},
          {"left_out", model.left_out},
          {"sh_degree", model.sh_degree},
          {"antialiased", model.antialiased}};
}

Json describe(const Path& path, const Path& models) {
  if (!std::filesystem::exists(path))
    throw Error("Cannot read " + path.string() +
                ": there is no such file or folder; check the path.");
  if (std::filesystem::is_directory(path)) {
    if (std::filesystem::exists(path / "avatar.json")) return describe_avatar(path);
    if (std::filesystem::exists(path / "capture.json")) return describe_capture(path);
    return describe_rig(load_rig(path, models));
  }
  std::string extension = path.extension().string();
  for (char& c : extension) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  if (extension == ".safetensors") return describe_tensors(path);
  if (extension == ".ply") return describe_ply(path);
  if (extension == ".pkl") return describe_rig(load_rig(path, models));
  if (extension == ".mp4" || extension == ".mov" || extension == ".mkv" || extension == ".webm" ||
      extension == ".avi")
    return describe_video(path);
  return describe_image(path);
}

}  // namespace

int run_info(int argc, char** argv) {
  CLI::App app(
      "Says what a file or folder is and reads all of it, so that damage shows: captures, "
      "avatars,\n"
      "rigs, images, environments, videos, safetensors, PLY files.\n\n"
      "example: effigy info anna",
      "info");
  std::string path, models;
  CommonOptions common;
  app.add_option("PATH", path, "File or folder")->required();
  app.add_option("--models", models, "Folder of networks (for landmark embeddings of rigs)");
  add_common(app, common, false, true);
  if (!parse_command_line(app, argc, argv, common)) return 0;
  Json description = describe(path, models);
  description["sound"] = true;
  if (common.json) {
    print_json(description);
    return 0;
  }
  for (const auto& [name, value] : description.items())
    std::printf("%-20s %s\n", name.c_str(),
                value.is_string() ? value.get<std::string>().c_str() : value.dump().c_str());
  return 0;
}

}  // namespace effigy
