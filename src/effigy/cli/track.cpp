// effigy track: a talking-head video becomes a capture.

#include <unistd.h>

#include <cstdio>
#include <iostream>

#include "effigy/base/log.h"
#include "effigy/cli/command_line.h"
#include "effigy/cli/commands.h"
#include "effigy/track/track.h"

namespace effigy {
namespace {

// Asked on a terminal only; nothing ever waits for an answer elsewhere.
std::string ask_consent() {
  if (!isatty(STDIN_FILENO) || !isatty(STDERR_FILENO)) return "not stated";
  std::fputs(
      "Did the person in this video agree to an avatar? Say what they agreed to (Enter: not "
      "stated): ",
      stderr);
  std::string answer;
  std::getline(std::cin, answer);
  return answer.empty() ? "not stated" : answer;
}

}  // namespace

int run_track(int argc, char** argv) {
  CLI::App app(
      "Turns a talking-head video into a capture: frames, mattes, landmarks, rig parameters, "
      "camera,\n"
      "with track.html to look at and track.json. Ten to twenty seconds of one person are "
      "enough.\n\n"
      "example: effigy track me.mp4 -o me-capture --consent \"my own video\"",
      "track");
  std::string video, output, rig, models, matte, crop = "head", consent;
  TrackOptions options;
  CommonOptions common;
  app.add_option("VIDEO", video, "Video file")->required();
  app.add_option("-o,--output", output, "Capture folder to write")->required();
  app.add_option("--rig", rig,
                 "ICT-FaceKit folder, FLAME .pkl or rig.safetensors (default: ICT-FaceKit under "
                 "$EFFIGY_DATA, else the built-in head)");
  app.add_option("--models", models, "Folder with face_landmarker.task or the npm networks");
  app.add_option("--crop", crop, "head (default: one square around the head) or none (whole frame)")
      ->check(CLI::IsMember({"head", "none"}));
  app.add_option("--size", options.size, "Side of the head crop in pixels (default 512)")
      ->check(CLI::Range(64, 4096));
  app.add_option("--matte", matte, "Folder of your own mattes, one picture a frame");
  app.add_option("--frames", options.most_frames, "Use only the first frames")->check(at_least(1));
  app.add_option("--test", options.test_frames,
                 "Hold out the last frames (default: a quarter, at most 350)")
      ->check(at_least(0));
  app.add_flag("--tolerant", options.tolerant,
               "Go on with several people in the picture, or long times without a face");
  app.add_option("--consent", consent, "What the person agreed to; recorded with the avatar");
  app.add_option("--licence", options.licence, "Licence of the video; recorded with the avatar");
  add_common(app, common, false, true);
  if (!parse_command_line(app, argc, argv, common)) return 0;
  if (!rig.empty()) options.rig = rig;
  if (!models.empty()) options.models = models;
  if (!matte.empty()) options.matte = matte;
  options.crop_head = crop == "head";
  options.consent = consent.empty() ? ask_consent() : consent;

  const Json summary = track_video(video, output, options);
  if (common.json) {
    print_json(summary);
  } else {
    std::printf(
        "%d of %d frames tracked, landmark error %.2f px, held out %.2f px, %.1f ms a frame\n%s\n",
        summary["tracked"].get<int>(), summary["frames"].get<int>(),
        summary["landmark_error_median_px"].get<double>(),
        summary["heldout_landmark_error_median_px"].get<double>(),
        summary["milliseconds_per_frame"].get<double>(), (Path(output) / "track.html").c_str());
  }
  return 0;
}

}  // namespace effigy
