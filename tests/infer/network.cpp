// The importer against plain double-precision loops, and against damaged files.
#include "effigy/infer/network.h"

#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <cstdlib>
#include <functional>

#include "effigy/base/error.h"
#include "effigy/base/random.h"
#include "effigy/infer/models.h"
#include "effigy/infer/tflite.h"
#include "infer/tflite_writer.h"

namespace effigy {
namespace {

using test::WrittenNetwork;

std::vector<float> noise(size_t count, uint64_t seed) {
  Random random(seed);
  std::vector<float> values(count);
  for (float& value : values) value = static_cast<float>(random.uniform(-1.0, 1.0));
  return values;
}

struct Picture {
  int height, width, channels;
  std::vector<double> data;
  double at(int y, int x, int c) const {
    if (y < 0 || x < 0 || y >= height || x >= width) return 0;
    return data[(static_cast<size_t>(y) * width + x) * channels + c];
  }
};

// TFLite's definition, written out: SAME puts the odd row of padding last.
Picture convolve(const Picture& in, const std::vector<float>& weights,
                 const std::vector<float>& bias, int outputs, int kernel, int stride, bool same,
                 bool depthwise) {
  const auto size = [&](int side) {
    return same ? (side + stride - 1) / stride : (side - kernel) / stride + 1;
  };
  Picture out{size(in.height), size(in.width), outputs, {}};
  const auto before = [&](int side, int result) {
    return same ? std::max((result - 1) * stride + kernel - side, 0) / 2 : 0;
  };
  const int top = before(in.height, out.height), left = before(in.width, out.width);
  for (int y = 0; y < out.height; ++y)
    for (int x = 0; x < out.width; ++x)
      for (int o = 0; o < outputs; ++o) {
        double sum = bias[o];
        for (int v = 0; v < kernel; ++v)
          for (int u = 0; u < kernel; ++u) {
            const int iy = y * stride - top + v, ix = x * stride - left + u;
            if (depthwise) {
              sum += in.at(iy, ix, o) * weights[(v * kernel + u) * outputs + o];
            } else {
              for (int c = 0; c < in.channels; ++c)
                sum +=
                    in.at(iy, ix, c) *
                    weights[((static_cast<size_t>(o) * kernel + v) * kernel + u) * in.channels + c];
            }
          }
        out.data.push_back(sum);
      }
  return out;
}

void expect_near(const Array& result, const std::vector<double>& expected, double tolerance) {
  ASSERT_EQ(result.data.size(), expected.size());
  for (size_t i = 0; i < expected.size(); ++i)
    ASSERT_NEAR(result.data[i], expected[i], tolerance) << "at " << i;
}

struct ConvolutionCase {
  int height, width, channels, outputs, kernel, stride;
  bool same, depthwise;
};

class Convolution : public testing::TestWithParam<ConvolutionCase> {};

TEST_P(Convolution, MatchesPlainLoops) {
  const ConvolutionCase c = GetParam();
  const int outputs = c.depthwise ? c.channels : c.outputs;
  const size_t weight_count =
      static_cast<size_t>(c.kernel) * c.kernel * outputs * (c.depthwise ? 1 : c.channels);
  const auto weights = noise(weight_count, 1), bias = noise(outputs, 2);
  const auto data = noise(static_cast<size_t>(c.height) * c.width * c.channels, 3);
  Picture in{c.height, c.width, c.channels, {data.begin(), data.end()}};
  const Picture expected =
      convolve(in, weights, bias, outputs, c.kernel, c.stride, c.same, c.depthwise);

  WrittenNetwork file;
  const int input = file.tensor({1, c.height, c.width, c.channels});
  const int w =
      file.floats(c.depthwise ? std::vector<int32_t>{1, c.kernel, c.kernel, outputs}
                              : std::vector<int32_t>{outputs, c.kernel, c.kernel, c.channels},
                  weights);
  const int b = file.floats({outputs}, bias);
  const int output = file.tensor({1, expected.height, expected.width, outputs});
  std::vector<test::WrittenOption> options = {
      {0, 1, c.same ? 0 : 1}, {1, 4, c.stride}, {2, 4, c.stride}};
  if (c.depthwise) options.push_back({3, 4, 1});
  file.nodes.push_back({c.depthwise ? 4 : 3, {input, w, b}, {output}, options, "", {}});
  file.inputs = {input};
  file.outputs = {output};
  Network network = Network::from_tflite(file.write(), "test");
  Array array({1, c.height, c.width, c.channels});
  array.data = data;
  expect_near(network.run({array})[0], expected.data, 2e-5);
  // Twice: nothing is left over from the first run.
  expect_near(network.run({array})[0], expected.data, 2e-5);
}

INSTANTIATE_TEST_SUITE_P(Shapes, Convolution,
                         testing::Values(ConvolutionCase{8, 8, 3, 5, 3, 2, true, false},
                                         ConvolutionCase{7, 9, 4, 6, 3, 2, true, false},
                                         ConvolutionCase{8, 6, 16, 8, 1, 1, true, false},
                                         ConvolutionCase{9, 9, 3, 4, 5, 2, true, false},
                                         ConvolutionCase{6, 6, 4, 3, 2, 2, false, false},
                                         ConvolutionCase{5, 7, 3, 4, 3, 1, false, false},
                                         ConvolutionCase{8, 8, 16, 0, 3, 1, true, true},
                                         ConvolutionCase{8, 8, 24, 0, 3, 2, true, true},
                                         ConvolutionCase{10, 8, 8, 0, 5, 2, true, true}));

// Activations alone and fused behind an addition: the same function.
double reference_activation(int code, double x, double slope) {
  switch (code) {
    case 19:
      return std::max(x, 0.0);
    case 21:
      return std::min(std::max(x, 0.0), 6.0);
    case 54:
      return x > 0 ? x : slope * x;
    case 117:
      return x * std::min(std::max(x + 3, 0.0), 6.0) / 6;
    default:
      return 1 / (1 + std::exp(-x));
  }
}

class Activations : public testing::TestWithParam<int> {};

TEST_P(Activations, AloneAndFused) {
  const int code = GetParam(), channels = 24;
  const auto slope = noise(channels, 5);
  auto data = noise(7 * 5 * channels, 6);
  for (float& value : data) value *= 8;
  for (const bool fused : {false, true}) {
    WrittenNetwork file;
    const int input = file.tensor({1, 7, 5, channels});
    const int slopes = file.floats({1, 1, channels}, slope);
    int source = input;
    if (fused) {
      source = file.tensor({1, 7, 5, channels});
      file.nodes.push_back({0, {input, input}, {source}, {}, "", {}});
    }
    const int output = file.tensor({1, 7, 5, channels});
    file.nodes.push_back(
        {code,
         code == 54 ? std::vector<int32_t>{source, slopes} : std::vector<int32_t>{source},
         {output},
         {},
         "",
         {}});
    file.inputs = {input};
    file.outputs = {output};
    Network network = Network::from_tflite(file.write(), "test");
    Array array({1, 7, 5, channels});
    array.data = data;
    std::vector<double> expected;
    for (size_t i = 0; i < data.size(); ++i)
      expected.push_back(
          reference_activation(code, fused ? 2.0 * data[i] : data[i], slope[i % channels]));
    expect_near(network.run({array})[0], expected, 1e-5);
  }
}
INSTANTIATE_TEST_SUITE_P(Codes, Activations, testing::Values(14, 19, 21, 54, 117));

TEST(Operators, PadPoolAddAndTransposedConvolution) {
  // input 4x4x2 -> max pool 2x2 -> PAD to 4 channels -> custom transposed convolution to 4x4x1
  const auto data = noise(4 * 4 * 2, 7), weights = noise(2 * 2 * 4, 8);
  WrittenNetwork file;
  const int input = file.tensor({1, 4, 4, 2});
  const int pooled = file.tensor({1, 2, 2, 2});
  file.nodes.push_back(
      {17, {input}, {pooled}, {{0, 1, 1}, {1, 4, 2}, {2, 4, 2}, {3, 4, 2}, {4, 4, 2}}, "", {}});
  const int amounts = file.ints({4, 2}, {0, 0, 0, 0, 0, 0, 0, 2});
  const int padded = file.tensor({1, 2, 2, 4});
  file.nodes.push_back({34, {pooled, amounts}, {padded}, {}, "", {}});
  const int w = file.floats({1, 2, 2, 4}, weights), b = file.floats({1}, {0.25f});
  const int output = file.tensor({1, 4, 4, 1});
  file.nodes.push_back({32,
                        {padded, w, b},
                        {output},
                        {},
                        "Convolution2DTransposeBias",
                        {1, 0, 0, 0, 2, 0, 0, 0, 2, 0, 0, 0}});
  file.inputs = {input};
  file.outputs = {output};
  Network network = Network::from_tflite(file.write(), "test");
  Array array({1, 4, 4, 2});
  array.data = data;
  std::vector<double> expected;
  for (int y = 0; y < 4; ++y)
    for (int x = 0; x < 4; ++x) {
      double sum = 0.25;
      for (int c = 0; c < 2; ++c) {
        double largest = -10;
        for (int v = 0; v < 2; ++v)
          for (int u = 0; u < 2; ++u)
            largest =
                std::max<double>(largest, data[((y / 2 * 2 + v) * 4 + x / 2 * 2 + u) * 2 + c]);
        sum += largest * weights[((y % 2) * 2 + x % 2) * 4 + c];
      }
      expected.push_back(sum);
    }
  expect_near(network.run({array})[0], expected, 1e-5);
}

TEST(Operators, ResizeUsesHalfPixelCentres) {
  WrittenNetwork file;
  const int input = file.tensor({1, 2, 2, 1});
  const int size = file.ints({2}, {4, 4});
  const int output = file.tensor({1, 4, 4, 1});
  file.nodes.push_back({23, {input, size}, {output}, {{3, 1, 1}}, "", {}});
  file.inputs = {input};
  file.outputs = {output};
  Network network = Network::from_tflite(file.write(), "test");
  Array array({1, 2, 2, 1});
  array.data = {0, 1, 2, 3};
  const double t[4] = {0, 0.25, 0.75, 1};
  std::vector<double> expected;
  for (const double v : t)
    for (const double u : t) expected.push_back(2 * v + u);
  expect_near(network.run({array})[0], expected, 1e-6);
}

TEST(Operators, NormalisationChain) {
  // The blendshape network's opening: subtract the mean over points, divide by the mean length.
  const auto data = noise(6 * 2, 9);
  WrittenNetwork file;
  const int input = file.tensor({1, 6, 2});
  const int points = file.ints({}, {-2}), last = file.ints({1}, {-1});
  const int mean = file.tensor({1, 1, 2}), off = file.tensor({1, 6, 2});
  const int square = file.tensor({1, 6, 2}), sum = file.tensor({1, 6, 1});
  const int length = file.tensor({1, 6, 1}), scale = file.tensor({1, 1, 1});
  const int output = file.tensor({1, 6, 2}), turned = file.tensor({1, 2, 6});
  const int order = file.ints({3}, {0, 2, 1});
  file.nodes.push_back({40, {input, points}, {mean}, {{0, 1, 1}}, "", {}});
  file.nodes.push_back({41, {input, mean}, {off}, {}, "", {}});
  file.nodes.push_back({18, {off, off}, {square}, {}, "", {}});
  file.nodes.push_back({74, {square, last}, {sum}, {{0, 1, 1}}, "", {}});
  file.nodes.push_back({75, {sum}, {length}, {}, "", {}});
  file.nodes.push_back({40, {length, points}, {scale}, {{0, 1, 1}}, "", {}});
  file.nodes.push_back({42, {off, scale}, {output}, {}, "", {}});
  file.nodes.push_back({39, {output, order}, {turned}, {}, "", {}});
  file.inputs = {input};
  file.outputs = {turned};
  Network network = Network::from_tflite(file.write(), "test");
  Array array({1, 6, 2});
  array.data = data;
  double m[2] = {0, 0}, mean_length = 0;
  for (int i = 0; i < 6; ++i)
    for (int c = 0; c < 2; ++c) m[c] += data[2 * i + c] / 6;
  for (int i = 0; i < 6; ++i)
    mean_length += std::hypot(data[2 * i] - m[0], data[2 * i + 1] - m[1]) / 6;
  std::vector<double> expected;
  for (int c = 0; c < 2; ++c)
    for (int i = 0; i < 6; ++i) expected.push_back((data[2 * i + c] - m[c]) / mean_length);
  expect_near(network.run({array})[0], expected, 1e-5);
}

WrittenNetwork small_network() {
  WrittenNetwork file;
  const int input = file.tensor({1, 4, 4, 2});
  // Half-precision weights through DEQUANTIZE, as MediaPipe stores them.
  const int half =
      file.constant<uint16_t>({3, 1, 1, 2}, {0x3c00, 0xbc00, 0x3800, 0, 0x4000, 0x3555}, 1);
  const int weights = file.tensor({3, 1, 1, 2});
  file.nodes.push_back({6, {half}, {weights}, {}, "", {}});
  const int bias = file.floats({3}, {0, 1, -1});
  const int output = file.tensor({1, 4, 4, 3});
  file.nodes.push_back(
      {3, {input, weights, bias}, {output}, {{0, 1, 0}, {1, 4, 1}, {2, 4, 1}, {3, 1, 1}}, "", {}});
  const int shape = file.ints({2}, {1, 48});
  const int flat = file.tensor({1, 48});
  file.nodes.push_back({22, {output, shape}, {flat}, {}, "", {}});
  file.inputs = {input};
  file.outputs = {flat};
  return file;
}

TEST(Network, FoldsHalfPrecisionConstants) {
  Network network = Network::from_tflite(small_network().write(), "test");
  Array array({1, 4, 4, 2});
  array.data[0] = 2;
  array.data[1] = 1;
  const auto result = network.run({array})[0];
  EXPECT_NEAR(result.data[0], 1.0, 1e-6);
  EXPECT_NEAR(result.data[1], 2.0, 1e-6);
  EXPECT_NEAR(result.data[2], 3.0 + 0.33325195, 1e-5);
  EXPECT_NEAR(result.data[4], 1.0, 1e-6);
  EXPECT_NEAR(result.data[5], 0.0, 1e-6) << "the fused ReLU is missing";
}

TEST(Tflite, HalfPrecisionIsExact) {
  EXPECT_EQ(float_from_half(0x3c00), 1.0f);
  EXPECT_EQ(float_from_half(0xc000), -2.0f);
  EXPECT_EQ(float_from_half(0x0001), 0x1.0p-24f);
  EXPECT_EQ(float_from_half(0x83ff), -1023 * 0x1.0p-24f);
  EXPECT_EQ(float_from_half(0x7bff), 65504.0f);
  EXPECT_TRUE(std::isinf(float_from_half(0x7c00)));
  EXPECT_TRUE(std::isnan(float_from_half(0x7e00)));
}

// Runs `attack` and demands a clean Error naming the network, or a sound network.
void expect_sound_or_error(const std::vector<uint8_t>& bytes) {
  try {
    Network network = Network::from_tflite(bytes, "hostile.tflite");
    std::vector<Array> inputs;
    for (const auto& shape : network.input_shapes()) inputs.emplace_back(shape);
    network.run(inputs);
  } catch (const Error& problem) {
    EXPECT_EQ(std::string(problem.what()).rfind("hostile.tflite: ", 0), 0U) << problem.what();
  }
}

TEST(Tflite, EveryTruncationIsRefused) {
  const auto bytes = small_network().write();
  for (size_t size = 0; size < bytes.size(); ++size) {
    // The last bytes may be padding: a file cut there may still be sound.
    expect_sound_or_error({bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(size)});
    if (size < bytes.size() / 2) {
      EXPECT_THROW(parse_tflite(std::span(bytes).first(size), "cut"), Error) << size;
    }
  }
}

TEST(Tflite, EveryByteMayBeHostile) {
  const auto bytes = small_network().write();
  for (size_t i = 0; i < bytes.size(); ++i)
    for (const int value : {0x00, 0x01, 0x7f, 0x80, 0xff}) {
      auto damaged = bytes;
      damaged[i] = static_cast<uint8_t>(value);
      expect_sound_or_error(damaged);
    }
}

TEST(Tflite, RandomDamageInSeveralPlaces) {
  const auto bytes = small_network().write();
  Random random(11);
  for (int round = 0; round < 3000; ++round) {
    auto damaged = bytes;
    for (int k = 0; k < 4; ++k)
      damaged[random.below(damaged.size())] = static_cast<uint8_t>(random.bits());
    expect_sound_or_error(damaged);
  }
}

TEST(Tflite, NamesWhatIsNotSupported) {
  WrittenNetwork file = small_network();
  file.nodes.back().code = 100;
  try {
    parse_tflite(file.write(), "odd.tflite");
    FAIL();
  } catch (const Error& problem) {
    EXPECT_NE(std::string(problem.what()).find("operator 100"), std::string::npos);
  }
  file = small_network();
  std::swap(file.nodes[1], file.nodes[2]);
  EXPECT_THROW(parse_tflite(file.write(), "order"), Error);
}

TEST(Models, MissingFolderAndEmptyFolderSayWhatToDo) {
  EXPECT_THROW(find_models(Path("/no/such/folder")), Error);
  const Path empty = Path(testing::TempDir()) / "effigy_no_models";
  std::filesystem::create_directories(empty);
  try {
    find_models(empty);
    FAIL();
  } catch (const Error& problem) {
    EXPECT_NE(std::string(problem.what()).find("--models"), std::string::npos);
    EXPECT_NE(std::string(problem.what()).find(empty.string()), std::string::npos);
  }
  write_text(empty / "face_landmarker.task", "this is no zip archive");
  EXPECT_THROW(find_models(empty), Error);
  std::filesystem::remove_all(empty);
}

TEST(Models, PublishedNetworksLoadAndRun) {
  const char* data = std::getenv("EFFIGY_DATA");
  if (data == nullptr || !std::filesystem::exists(Path(data) / "models/face_landmarker.task"))
    GTEST_SKIP() << "set EFFIGY_DATA to a folder with models/face_landmarker.task to run this";
  const ModelSet models = find_models(Path(data) / "models");
  EXPECT_EQ(models.landmark_count, 478);
  struct Part {
    const std::vector<uint8_t>& bytes;
    std::vector<int64_t> input;
    size_t outputs;
  };
  for (const Part& part :
       {Part{models.detector, {1, 128, 128, 3}, 896 * 16},
        Part{models.landmarks, {1, 256, 256, 3}, 1434}, Part{models.blendshapes, {1, 146, 2}, 52},
        Part{models.matte, {1, 256, 256, 3}, 65536}}) {
    Network network = Network::from_tflite(part.bytes, "published");
    ASSERT_EQ(network.input_shapes()[0], part.input);
    Array input(part.input);
    input.data = noise(input.data.size(), 4);
    const auto outputs = network.run({input});
    ASSERT_EQ(outputs[0].data.size(), part.outputs);
    for (const float value : outputs[0].data) ASSERT_TRUE(std::isfinite(value));
    // Damage in the real file's structure as well.
    auto damaged = part.bytes;
    damaged.resize(damaged.size() / 2);
    EXPECT_THROW(Network::from_tflite(damaged, "half a file"), Error);
  }
}

}  // namespace
}  // namespace effigy
