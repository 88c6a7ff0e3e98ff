#include "effigy/head/encoder_start.h"

#include <cmath>

#include "support.h"
#include "tiny_capture.h"

namespace effigy {
namespace {

// Frames that differ in a turn of the head, much, and in the expression, independently.
Capture two_ways(const Path& folder) {
  test::write_tiny_capture(folder, 16);
  Capture capture = read_capture(folder);
  for (size_t f = 0; f < capture.frames.size(); ++f) {
    capture.poses[f].joint_rotation[1] = f % 2 == 0 ? 0.1f : -0.1f;
    capture.poses[f].expression[0] = f % 4 < 2 ? 0.3f : 0.1f;
    capture.poses[f].translation[2] = f % 2 == 0 ? -1.0f : -1.1f;
  }
  return capture;
}

TEST(EncoderStart, CodesAreTheWaysInWhichFramesDiffer) {
  test::ScratchFolder scratch;
  const Capture capture = two_ways(scratch.path());
  std::vector<int> frames;
  for (int f = 0; f < 16; ++f) frames.push_back(f);
  const FrameEncoder encoder = start_encoder(capture, frames, 24, 3);
  ASSERT_EQ(encoder.code_size(), 2u);  // there are no others
  // Rotation and translation vary together, so by 2 in all; the expression by 1.
  const double second = std::pow(0.5, 0.25);
  EXPECT_FLOAT_EQ(encoder.limit[0], 3.0f);
  EXPECT_NEAR(encoder.limit[1], 3 * second, 1e-4);
  double mean[2] = {0, 0}, square[2] = {0, 0};
  for (const int f : frames) {
    const std::vector<float> code = encoder.code(encoder.inputs(capture, f));
    for (size_t k = 0; k < 2; ++k) {
      mean[k] += code[k] / 16;
      square[k] += code[k] * code[k] / 16;
    }
    EXPECT_EQ(code[0] > 0, (encoder.code(encoder.inputs(capture, 0))[0] > 0) == (f % 2 == 0));
  }
  EXPECT_NEAR(mean[0], 0, 1e-4);
  EXPECT_NEAR(mean[1], 0, 1e-4);
  EXPECT_NEAR(std::sqrt(square[0]), 1, 1e-3);
  EXPECT_NEAR(std::sqrt(square[1]), second, 1e-3);
  for (const float w : encoder.weights) EXPECT_EQ(w, 0.0f);
}

TEST(EncoderStart, FewerCodesWhereFewerAreAskedFor) {
  test::ScratchFolder scratch;
  const Capture capture = two_ways(scratch.path());
  const FrameEncoder encoder = start_encoder(capture, {0, 1, 2, 3, 4, 5}, 1, 2);
  EXPECT_EQ(encoder.code_size(), 1u);
  EXPECT_FLOAT_EQ(encoder.limit[0], 2.0f);
}

TEST(EncoderStart, FramesThatAreAllAlike) {
  test::ScratchFolder scratch;
  Capture capture = two_ways(scratch.path());
  for (RigPose& pose : capture.poses) pose = capture.poses[0];
  const FrameEncoder encoder = start_encoder(capture, {0, 1, 2, 3}, 24, 3);
  const std::vector<float> code = encoder.code(encoder.inputs(capture, 1));
  for (const float c : code) EXPECT_EQ(c, 0.0f);
}

}  // namespace
}  // namespace effigy
