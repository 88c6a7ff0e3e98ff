// effigy import: the recordings of other light stages become captures.

#include "effigy/capture/import_stage.h"

#include <cstdio>

#include "effigy/base/log.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"

namespace effigy {

int run_import(int argc, char** argv) {
  CLI::App app(
      "Makes a capture of a light-stage recording in another layout (docs/body-data.md):\n"
      "  goliath     Goliath-4: a folder with camera_calibration.json, image/cam….zip, lights/\n"
      "  humanolat   HumanOLAT: the folder of one pose, its subject's folder shared/ beside it\n"
      "  transforms  NRHints, GS3: a folder with transforms_train.json, a point light a picture\n"
      "Partial frames are left out and counted. Pictures become PNGs.\n\n"
      "example: effigy import humanolat SUBJECT_C003/POSE_00 -o c003 --scale 0.5",
      "import");
  std::string kind, source, output, mesh;
  StageImportOptions options;
  CommonOptions common;
  app.add_option("KIND", kind, "goliath, humanolat or transforms")
      ->required()
      ->check(CLI::IsMember(stage_import_kinds()));
  app.add_option("SOURCE", source, "Folder of the recording")->required();
  app.add_option("-o,--output", output, "Capture folder to write")->required();
  app.add_option("--mesh", mesh,
                 "OBJ with texture coordinates, in the source's units: the tracked mesh; for "
                 "goliath its triangles and texture coordinates");
  app.add_option("--up", options.up,
                 "Axis of the source's world that points up: x, y, z, -x, -y, -z (default y; z for "
                 "transforms)");
  app.add_option("--cameras", options.cameras, "Only these, by name (cam400870 Cam01 camera0000)");
  app.add_option("--every", options.every, "Of the frames every n-th (default 1)");
  app.add_option("--frames", options.frames, "At most so many, evenly spread (default all)");
  app.add_option("--scale", options.scale, "Shrinks the pictures by this factor (default 1)");
  app.add_option("--light-scale", options.light_scale,
                 "Factor on the source's light intensities (default: so that surfaces come out "
                 "with a mean albedo of 0.4)");
  app.add_option("--consent", options.consent, "What the person agreed to; kept in the capture");
  add_common(app, common, false, true);
  if (!parse_command_line(app, argc, argv, common)) return 0;
  options.mesh = mesh;
  const StageImportReport report = import_stage(kind, source, options, output);
  if (common.json) {
    print_json({{"cameras", report.cameras},
                {"frames", report.frames},
                {"views", report.views},
                {"frames_left_out", report.frames_left_out},
                {"views_left_out", report.views_left_out},
                {"first_problem", report.first_problem},
                {"light_scale", report.light_scale}});
  } else {
    std::printf("%d cameras, %d frames, %zu views (left out: %d frames, %zu views)\n",
                report.cameras, report.frames, report.views, report.frames_left_out,
                report.views_left_out);
  }
  return 0;
}

}  // namespace effigy
