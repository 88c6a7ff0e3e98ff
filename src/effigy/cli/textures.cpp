// effigy textures: materials out as PNGs, painted ones back in.

#include "effigy/avatar/textures.h"

#include "effigy/avatar/kind.h"
#include "effigy/base/log.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"
#include "effigy/rig/rig_file.h"

namespace effigy {
namespace {

UvRectangle rectangle_of(const std::string& text) {
  UvRectangle where = {0, 0, 1, 1};
  if (text.empty()) return where;
  const auto numbers = parse_numbers(text, 4, "--rect");
  std::copy(numbers.begin(), numbers.end(), where.begin());
  return where;
}

int edit_body(const std::string& avatar, const std::string& action, const std::string& folder,
              const std::string& rectangle) {
  const Path textures = Path(avatar) / "textures";
  MaterialImages maps = read_maps(textures);
  if (maps.albedo.empty() || maps.roughness.empty())
    throw Error(textures.string() + ": albedo.png or roughness.png is missing; train again.");
  maps.specular = maps.normal = {};
  if (action == "export") {
    write_maps(folder, maps);
    log_info(format("wrote albedo and roughness ({} x {}) to {}", maps.albedo.width,
                    maps.albedo.height, folder));
    return 0;
  }
  const int applied = apply_edits(folder, rectangle_of(rectangle), maps);
  FolderWriter writer(textures, "albedo.png");
  write_maps(writer.dir(), maps);
  writer.commit();
  log_info(format("applied {} map(s) of {} to {}", applied, folder, avatar));
  return 0;
}

}  // namespace

int run_textures(int argc, char** argv) {
  CLI::App app(
      "Exports an avatar's material textures as 16-bit PNGs, or applies painted ones.\n"
      "albedo.png is sRGB; roughness, specular (F0) and normal (OpenGL) are linear; bodies have "
      "the "
      "first\n"
      "two. When applying, an alpha channel is the edit's mask.\n\n"
      "example: effigy textures anna export anna-paint\n"
      "         effigy textures anna apply anna-paint\n"
      "         effigy textures anna apply star --rect 0.4,0.6,0.5,0.7",
      "textures");
  std::string avatar_path, action, folder, rectangle;
  CommonOptions common;
  app.add_option("AVATAR", avatar_path, "Avatar folder")->required();
  app.add_option("ACTION", action, "export or apply")
      ->required()
      ->check(CLI::IsMember({"export", "apply"}));
  app.add_option("DIR", folder, "Folder of the PNGs")->required();
  app.add_option("--rect", rectangle,
                 "apply: UV rectangle u0,v0,u1,v1 (v up) that the images fill, e.g. for a decal");
  add_common(app, common, false, false);
  if (!parse_command_line(app, argc, argv, common)) return 0;

  const Path textures = Path(avatar_path) / "textures";
  const bool body = avatar_kind(avatar_path) == "body";
  read_rig(Path(avatar_path) / "rig.safetensors");  // maps belong to its texture coordinates
  if (body) return edit_body(avatar_path, action, folder, rectangle);
  MaterialTexture material = read_material(textures);
  if (action == "export") {
    write_material(folder, material);
    log_info(format("wrote albedo, roughness, specular and normal ({} x {}) to {}", material.width,
                    material.height, folder));
    return 0;
  }
  const int applied = apply_edits(folder, rectangle_of(rectangle), material);
  FolderWriter writer(textures, "albedo.png");
  write_material(writer.dir(), material);
  writer.commit();
  log_info(format("applied {} map(s) of {} to {}", applied, folder, avatar_path));
  return 0;
}

}  // namespace effigy
