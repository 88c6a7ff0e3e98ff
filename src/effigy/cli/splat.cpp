// effigy splat: the bare rasterizers on a described scene or a 3DGS PLY file.

#include <algorithm>
#include <cmath>
#include <numbers>

#include "effigy/base/log.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"
#include "effigy/image/colour.h"
#include "effigy/image/files.h"
#include "effigy/splat/gaussian_ply.h"
#include "effigy/splat/gaussian_scene_file.h"
#include "effigy/splat/scene_file.h"

namespace effigy {
namespace {

struct SplatOptions {
  std::string scene, out;
  bool gradients = false;
  // PLY files
  std::string camera, size = "768,768", background = "0,0,0", up = "-y", antialias = "auto";
  double turn = 0, elevation = 0, distance = 0, fov = 40, near = 0.2;
};

void splat_surfels(const SplatOptions& options) {
  const SplatScene scene = read_splat_scene(options.scene);
  Planes upstream;
  if (options.gradients) upstream = read_splat_upstream(options.scene, scene.camera);
  const SurfelRasterOptions raster = splat_scene_options();
  Planes gbuffer;
  SurfelFrame frame;
  render_surfels(scene.camera, scene.surfels, scene.texture, raster, gbuffer, frame);
  write_splat_outputs(options.out, gbuffer);
  if (options.gradients) {
    PosedSurfels d_surfels;
    d_surfels.resize(scene.surfels.count());
    std::vector<float> d_texels(scene.texture.texels.size());
    render_surfels_backward(scene.camera, scene.surfels, scene.texture, raster, gbuffer, frame,
                            upstream, d_surfels, d_texels);
    write_splat_gradients(options.out, d_surfels, d_texels);
  }
  log_info(format("{} surfels, {} blended surfel-pixel pairs; wrote {}", scene.surfels.count(),
                  frame.pairs(), options.out));
}

void splat_gaussians(const SplatOptions& options) {
  const GaussianScene scene = read_gaussian_scene(options.scene);
  const GaussianView view = scene.gaussians.view();
  Planes upstream;
  if (options.gradients) upstream = read_gaussian_upstream(options.scene, scene);
  const GaussianRasterOptions raster;
  Planes image;
  GaussianFrame frame;
  render_gaussians(scene.camera, view, raster, image, frame);
  write_gaussian_outputs(options.out, image);
  if (options.gradients) {
    Gaussians d;
    d.channels = view.channels;
    d.resize(view.count());
    render_gaussians_backward(scene.camera, view, raster, image, frame, upstream,
                              {d.center, d.rotation, d.scale, d.opacity, d.features, {}});
    write_gaussian_gradients(options.out, d);
  }
  log_info(format("{} Gaussians, {} blended Gaussian-pixel pairs; wrote {}", view.count(),
                  frame.pairs(), options.out));
}

Vec3d axis_named(const std::string& name) {
  const bool negative = !name.empty() && name[0] == '-';
  const std::string letter = name.substr(negative ? 1 : 0);
  if (letter != "x" && letter != "y" && letter != "z")
    throw Error("--up must be x, y, z, -x, -y or -z, not '" + name + "'.");
  return (negative ? -1.0 : 1.0) * Vec3d::Unit(letter[0] - 'x');
}

// The middle of the Gaussians and the distance from it within which 9 of 10 lie.
struct Extent {
  Vec3d center;
  double radius;
};
Extent extent_of(const Gaussians& g) {
  const size_t n = g.count();
  Extent extent{Vec3d::Zero(), 0.0};
  std::vector<double> values(n);
  const auto quantile = [&](size_t rank) {
    std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(rank),
                     values.end());
    return values[rank];
  };
  for (int k = 0; k < 3; ++k) {
    for (size_t i = 0; i < n; ++i)
      values[i] = static_cast<double>(g.center[3 * i + static_cast<size_t>(k)]);
    extent.center[k] = quantile(n / 2);
  }
  for (size_t i = 0; i < n; ++i) {
    const float* c = g.center.data() + 3 * i;
    values[i] = (Vec3d(c[0], c[1], c[2]) - extent.center).norm();
  }
  extent.radius = std::max(1e-6, quantile(n * 9 / 10));
  return extent;
}

// A camera that circles the Gaussians. At angle 0 it looks along the file's z axis (y axis when z
// is up).
Camera orbit(const SplatOptions& options, const Gaussians& gaussians) {
  constexpr double kRadians = std::numbers::pi / 180.0;
  const std::vector<double> size = parse_numbers(options.size, 2, "--size");
  if (!(size[0] >= 1 && size[0] <= 16384 && size[1] >= 1 && size[1] <= 16384))
    throw Error("--size must be two numbers from 1 to 16384.");
  if (!(options.fov > 0 && options.fov < 179))
    throw Error("--fov must lie between 0 and 179 degrees.");
  const Extent extent = extent_of(gaussians);
  const Vec3d up = axis_named(options.up);
  const Vec3d forward = std::abs(up.z()) > 0.5 ? Vec3d(0, 1, 0) : Vec3d(0, 0, 1);
  const Vec3d right = forward.cross(up);
  const double turn = options.turn * kRadians, elevation = options.elevation * kRadians;
  const double distance = options.distance > 0
                              ? options.distance
                              : 1.2 * extent.radius / std::sin(0.5 * options.fov * kRadians);
  const Vec3d from = std::cos(elevation) * (std::sin(turn) * right - std::cos(turn) * forward) +
                     std::sin(elevation) * up;
  // look_at has y up: the scene is turned so that `up` is y, and the camera back.
  const Mat3d turned = Eigen::Quaterniond::FromTwoVectors(up, Vec3d::UnitY()).toRotationMatrix();
  Camera camera = look_at(turned * (distance * from), Vec3d::Zero(), options.fov * kRadians,
                          static_cast<int>(size[0]), static_cast<int>(size[1]));
  camera.camera_from_world_rotation = camera.camera_from_world_rotation * turned;
  camera.camera_from_world_translation -= camera.camera_from_world_rotation * extent.center;
  return camera;
}

void splat_ply(const SplatOptions& options) {
  if (options.gradients)
    throw Error("--gradients works on described scenes, not on PLY files; leave it out.");
  const std::string kind = Path(options.out).extension().string();
  if (kind != ".png" && kind != ".exr")
    throw Error("-o must name a .png or .exr file when a PLY file is drawn.");
  GaussianModel model = read_gaussian_ply(options.scene);
  if (model.left_out > 0)
    log_warning(format("{}: {} Gaussians hold values that cannot be drawn and were left out",
                       options.scene, model.left_out));
  const Camera camera =
      options.camera.empty() ? orbit(options, model.gaussians) : read_scene_camera(options.camera);
  colour_gaussians(model, camera.center(), model.gaussians.features);
  GaussianRasterOptions raster;
  raster.near = static_cast<float>(options.near);
  raster.compensate =
      options.antialias == "on" || (options.antialias == "auto" && model.antialiased);
  for (const double x : parse_numbers(options.background, 3, "--background"))
    raster.background.push_back(static_cast<float>(x));
  Planes drawn;
  GaussianFrame frame;
  render_gaussians(camera, model.gaussians.view(), raster, drawn, frame);
  Image image(camera.width, camera.height, 3);
  for (size_t i = 0; i < drawn.pixels(); ++i)
    for (int c = 0; c < 3; ++c) image.data[3 * i + static_cast<size_t>(c)] = drawn.plane(1 + c)[i];
  if (kind == ".png") {
    write_png8(options.out, to_8bit(image));
  } else {
    for (float& x : image.data) x = linear_from_srgb(std::max(0.0f, x));
    write_exr(options.out, image);
  }
  log_info(format("{} Gaussians, {} in view, {} blended Gaussian-pixel pairs; wrote {}",
                  model.count(), frame.visible(), frame.pairs(), options.out));
}

}  // namespace

int run_splat(int argc, char** argv) {
  CLI::App app(
      "The bare rasterizers, for tests, teaching and comparison with others.\n"
      "SCENE is a folder that describes textured surfels or 3D Gaussians (scene.json and raw\n"
      "float32 arrays): the raw buffers are written, and their gradients. Or it is a PLY file of\n"
      "3D Gaussians (3DGS): a picture is drawn. See docs/formats.md and docs/rasterizers.md.\n\n"
      "example: effigy splat scenes/soup -o out --gradients\n"
      "         effigy splat point_cloud.ply -o view.png --turn 30",
      "splat");
  SplatOptions options;
  CommonOptions common;
  app.add_option("SCENE", options.scene, "Folder with scene.json, or a .ply file")->required();
  app.add_option("-o,--output", options.out, "Folder for alpha.f32, ...; or a .png or .exr file")
      ->required();
  app.add_flag("--gradients", options.gradients,
               "Also read upstream_*.f32 and write the derivatives grad_*.f32");
  app.add_option(
      "--camera", options.camera,
      "PLY: JSON file with width height fx fy cx cy camera_from_world (default: a camera "
      "that circles the Gaussians)");
  app.add_option("--turn", options.turn, "PLY: degrees around the Gaussians (default 0)");
  app.add_option("--elevation", options.elevation, "PLY: degrees above them (default 0)");
  app.add_option("--distance", options.distance, "PLY: from their middle (default: all in view)");
  app.add_option("--fov", options.fov, "PLY: vertical field of view, degrees (default 40)");
  app.add_option("--up", options.up, "PLY: the axis that points up (default -y)");
  app.add_option("--size", options.size, "PLY: width,height in pixels (default 768,768)");
  app.add_option("--near", options.near,
                 "PLY: nothing nearer to the camera's plane is drawn (default 0.2)");
  app.add_option("--background", options.background, "PLY: r,g,b, sRGB (default 0,0,0)");
  app.add_option("--antialias", options.antialias,
                 "PLY: compensate opacity for the screen blur: auto (as the file says), on, off")
      ->check(CLI::IsMember({"auto", "on", "off"}));
  add_common(app, common, false, false);
  if (!parse_command_line(app, argc, argv, common)) return 0;
  const Path path = options.scene;
  if (path.extension() == ".ply" || std::filesystem::is_regular_file(path))
    splat_ply(options);
  else if (splat_scene_kind(options.scene) == SplatSceneKind::kGaussians)
    splat_gaussians(options);
  else
    splat_surfels(options);
  return 0;
}

}  // namespace effigy
