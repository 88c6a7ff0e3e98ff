// effigy splat: the bare surfel rasterizer on a described scene.

#include "effigy/base/log.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"
#include "effigy/splat/scene_file.h"

namespace effigy {

int run_splat(int argc, char** argv) {
  CLI::App app(
      "Draws a described scene of textured surfels and writes the raw buffers, for tests,\n"
      "teaching and comparison with other rasterizers. SCENE holds scene.json and raw float32\n"
      "arrays; see docs/formats.md.\n\n"
      "example: effigy splat scenes/soup -o out --gradients",
      "splat");
  std::string scene_path, out;
  bool gradients = false;
  CommonOptions common;
  app.add_option("SCENE", scene_path, "Folder with scene.json")->required();
  app.add_option("-o,--output", out, "Folder for alpha.f32, depth.f32, ...")->required();
  app.add_flag("--gradients", gradients,
               "Also read upstream_*.f32 and write the derivatives grad_*.f32");
  add_common(app, common, false, false);
  if (!parse_command_line(app, argc, argv, common)) return 0;

  const SplatScene scene = read_splat_scene(scene_path);
  Planes upstream;
  if (gradients) upstream = read_splat_upstream(scene_path, scene.camera);
  const SurfelRasterOptions options = splat_scene_options();
  Planes gbuffer;
  SurfelFrame frame;
  render_surfels(scene.camera, scene.surfels, scene.texture, options, gbuffer, frame);
  write_splat_outputs(out, gbuffer);
  if (gradients) {
    PosedSurfels d_surfels;
    d_surfels.resize(scene.surfels.count());
    std::vector<float> d_texels(scene.texture.texels.size());
    render_surfels_backward(scene.camera, scene.surfels, scene.texture, options, gbuffer, frame,
                            upstream, d_surfels, d_texels);
    write_splat_gradients(out, d_surfels, d_texels);
  }
  log_info(format("{} surfels, {} blended surfel-pixel pairs; wrote {}", scene.surfels.count(),
                  frame.pairs(), out));
  return 0;
}

}  // namespace effigy
