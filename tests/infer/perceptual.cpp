// LPIPS and feature_squeezenet10 against plain double-precision loops, with random weights in the
// published layouts; wrong files; and the real SqueezeNet when it is there.
#include "effigy/infer/perceptual.h"

#include "effigy/base/random.h"
#include "effigy/infer/deep_compression.h"
#include "infer/perceptual_files.h"
#include "infer/perceptual_oracle.h"
#include "support.h"

namespace effigy {
namespace {

using test::contains;
using test::error_of;
using test::Feature;
using test::LayerSize;
using test::PerceptualOracle;
using test::TorchForm;
using test::TorchState;

// Smooth colours with some noise.
Image picture(int width, int height, uint64_t seed) {
  Random random(seed);
  const double fx = random.uniform(2.0, 9.0), fy = random.uniform(2.0, 9.0);
  Image image(width, height, 3);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      for (int c = 0; c < 3; ++c)
        image.at(x, y)[c] = static_cast<float>(
            0.5 + 0.3 * std::sin(fx * x / width + c) * std::cos(fy * y / height - c) +
            random.uniform(-0.2, 0.2));
  return image;
}

test::WeightsByName by_name(const TorchState& state) {
  test::WeightsByName weights;
  for (const test::TorchEntry& entry : state) weights[entry.name] = entry.values;
  return weights;
}

std::vector<LayerSize> layers_of(const std::string& net) {
  if (net == "alex") return test::alex_layers();
  return net == "vgg" ? test::vgg_layers() : test::squeeze_layers();
}

// The files of one net with random weights, written once.
struct NetFiles {
  test::ScratchFolder folder;
  TorchState backbone, heads;
  Path backbone_path, heads_path;

  explicit NetFiles(const std::string& net, bool zip) {
    TorchForm form;
    form.zip = zip;
    backbone = test::random_backbone(layers_of(net), 7);
    heads = test::random_heads(test::head_channels(net), 8);
    backbone_path = folder / "backbone.pth";
    heads_path = folder / "heads.pth";
    test::write_torch(backbone, backbone_path, form);
    form.python2 = !zip;
    test::write_torch(heads, heads_path, form);
  }
};
const NetFiles& files_of(const std::string& net) {
  static const NetFiles alex("alex", false), vgg("vgg", true), squeeze("squeeze", true);
  if (net == "alex") return alex;
  return net == "vgg" ? vgg : squeeze;
}

// One net's distance, and double-precision loops over the same weights.
class Lpips : public ::testing::TestWithParam<const char*> {
 protected:
  std::string net = GetParam();
  const NetFiles& files = files_of(net);
  PerceptualDistance lpips = PerceptualDistance::lpips(net, files.backbone_path, files.heads_path);

  std::vector<Feature> features(const Image& image, bool unit_range) const {
    const Feature x = PerceptualOracle::lpips_input(image, unit_range);
    PerceptualOracle oracle(weights_);
    return net == "alex" ? oracle.alex(x) : (net == "vgg" ? oracle.vgg(x) : oracle.squeeze(x));
  }
  std::vector<std::vector<float>> heads() const {
    std::vector<std::vector<float>> values;
    for (const test::TorchEntry& head : files.heads) values.push_back(head.values);
    return values;
  }

 private:
  test::WeightsByName weights_ = by_name(files.backbone);
};

TEST_P(Lpips, IsThePapersFormula) {
  // Odd sides: what pools leave over must be treated as torchvision does.
  const Image a = net == "vgg" ? picture(35, 18, 1) : picture(70, 53, 1);
  const Image b = net == "vgg" ? picture(35, 18, 2) : picture(70, 53, 2);
  const double expected =
      PerceptualOracle::distance(features(a, false), features(b, false), heads());
  EXPECT_GT(expected, 0.01);
  EXPECT_NEAR(lpips.between(a, b), expected, 2e-5 * expected);
  const double unit = PerceptualOracle::distance(features(a, true), features(b, true), heads());
  EXPECT_GT(std::fabs(unit - expected), 1e-3 * expected);
  EXPECT_NEAR(lpips.between_unit_range(a, b), unit, 2e-5 * unit);
}

TEST_P(Lpips, IdentityAndSymmetry) {
  const Image a = picture(40, 40, 3), b = picture(40, 40, 4);
  EXPECT_EQ(lpips.between(a, a), 0);
  EXPECT_DOUBLE_EQ(lpips.between(a, b), lpips.between(b, a));
  EXPECT_EQ(lpips.between(a, b), lpips.between(a, b));
  // Black on black: features may be all zero, the guarded norm must not make NaN of it.
  const Image black(40, 40, 3);
  EXPECT_EQ(lpips.between(black, black), 0);
  EXPECT_TRUE(
      contains(error_of([&] { lpips.between(Image(9, 9, 3), Image(9, 9, 3)); }), "too small"));
}
INSTANTIATE_TEST_SUITE_P(Nets, Lpips, ::testing::Values("alex", "vgg", "squeeze"));

Planes planes_of(const Image& image) {
  Planes planes(image.width, image.height, 3);
  for (size_t p = 0; p < planes.pixels(); ++p)
    for (int c = 0; c < 3; ++c) planes.plane(c)[p] = image.data[3 * p + static_cast<size_t>(c)];
  return planes;
}

// A loss is the metric, and its gradient what double-precision differences of the oracle say.
void check_gradient(const PerceptualDistance& distance, const Image& a, const Image& b,
                    const std::function<double(const Image&)>& oracle) {
  constexpr float kWeight = 0.7f;
  Planes gradient(a.width, a.height, 3, 1.0f);
  const double value = distance.loss(planes_of(a), planes_of(b), kWeight, gradient);
  EXPECT_EQ(value, distance.between(a, b));
  // About the gradient's own direction, for the distance bends sharply where few channels are lit.
  double size = 0;
  for (const float d : gradient.data) size += static_cast<double>((d - 1) * (d - 1));
  Random random(12);
  const double step = 1e-3 / std::sqrt(size);
  Image ends[2] = {a, a};
  double along = 0;
  for (size_t i = 0; i < a.data.size(); ++i) {
    const double d = static_cast<double>(gradient.plane(static_cast<int>(i % 3))[i / 3] - 1);
    const auto moved = static_cast<float>(step * d * random.uniform(0.0, 2.0));
    ends[0].data[i] -= moved;
    ends[1].data[i] += moved;
    along += d * static_cast<double>(ends[1].data[i] - ends[0].data[i]);
  }
  const double measured = kWeight * (oracle(ends[1]) - oracle(ends[0]));
  EXPECT_GT(along, 1e-5);
  EXPECT_NEAR(measured, along, 0.01 * along);
}

TEST_P(Lpips, LossHasTheMetricsGradient) {
  const Image a = picture(37, 33, 1), b = picture(37, 33, 2);
  const std::vector<Feature> of_b = features(b, false);
  check_gradient(lpips, a, b, [&](const Image& image) {
    return PerceptualOracle::distance(features(image, false), of_b, heads());
  });
}

TEST_P(Lpips, LossOfSmallAndOfBlackPictures) {
  // Continued in black: the same as a larger picture that is black there.
  const Image a = picture(12, 40, 3), b = picture(12, 40, 4);
  Image wide_a(32, 40, 3), wide_b(32, 40, 3);
  for (int y = 0; y < 40; ++y)
    for (int i = 0; i < 36; ++i) {
      wide_a.at(0, y)[i] = a.at(0, y)[i];
      wide_b.at(0, y)[i] = b.at(0, y)[i];
    }
  Planes gradient(12, 40, 3);
  EXPECT_EQ(lpips.loss(planes_of(a), planes_of(b), 1, gradient), lpips.between(wide_a, wide_b));
  Planes black(40, 40, 3), none(40, 40, 3);
  EXPECT_EQ(lpips.loss(black, black, 1, none), 0);
  EXPECT_GT(lpips.loss(black, planes_of(picture(40, 40, 5)), 1, none), 0);
  for (const float d : none.data) ASSERT_TRUE(std::isfinite(d));
}

TEST(LpipsFiles, WrongOnesAreFoundOut) {
  const auto refusal = [](const std::string& net, const Path& backbone, const Path& heads) {
    return error_of([&] { PerceptualDistance::lpips(net, backbone, heads); });
  };
  const NetFiles &alex = files_of("alex"), &squeeze = files_of("squeeze");
  // Another net's backbone: the first tensor that does not fit is named with both sizes.
  const std::string other = refusal("alex", squeeze.backbone_path, alex.heads_path);
  EXPECT_TRUE(contains(other, squeeze.backbone_path.string()) &&
              contains(other, "'features.0.weight' is 64x3x3x3 instead of 64x3x11x11"))
      << other;
  EXPECT_TRUE(contains(refusal("vgg", squeeze.backbone_path, files_of("vgg").heads_path),
                       "there is no 'features.2.weight'"));
  // Heads for backbone and the other way round: the error people make.
  EXPECT_TRUE(contains(refusal("alex", alex.heads_path, alex.heads_path),
                       "there is no 'features.0.weight'; its first tensor is 'lin0"));
  EXPECT_TRUE(contains(refusal("alex", alex.backbone_path, alex.backbone_path),
                       "there is no 'lin0.model.1.weight'; this is a backbone"));
  // Another net's heads.
  const std::string heads = refusal("alex", alex.backbone_path, squeeze.heads_path);
  EXPECT_TRUE(contains(heads, squeeze.heads_path.string()) &&
              contains(heads, "'lin1.model.1.weight' is 1x128x1x1 instead of 1x192x1x1"))
      << heads;

  const test::ScratchFolder scratch;
  const auto changed_heads = [&](const std::function<void(TorchState&)>& change) {
    TorchState state = alex.heads;
    change(state);
    test::write_torch(state, scratch / "heads.pth");
    return refusal("alex", alex.backbone_path, scratch / "heads.pth");
  };
  EXPECT_TRUE(contains(changed_heads([](TorchState& s) { s[2].values[5] = -0.1f; }),
                       "'lin2.model.1.weight' holds a negative weight"));
  EXPECT_TRUE(contains(changed_heads([](TorchState& s) { s[2].values[5] = INFINITY; }),
                       "'lin2.model.1.weight' holds a value that is not finite"));
  EXPECT_TRUE(contains(changed_heads([](TorchState& s) {
                         s.push_back({"lin5.model.1.weight", {1, 2, 1, 1}, {1, 1}});
                       }),
                       "'lin5.model.1.weight' too many"));
  TorchState biasless = alex.backbone;
  biasless.pop_back();
  test::write_torch(biasless, scratch / "net.pth");
  EXPECT_TRUE(contains(refusal("alex", scratch / "net.pth", alex.heads_path),
                       "there is no 'features.10.bias'"));
}

TEST(FeatureSqueezenet10, IsTheFormulaOnTheDecodedFile) {
  TorchState state = test::random_backbone(test::squeeze10_layers(), 9);
  const std::string file = test::deep_compressed(state, 10);
  const test::ScratchFolder scratch;
  write_text(scratch / "net.net", file);
  const PerceptualDistance distance = PerceptualDistance::squeezenet10(scratch / "net.net");
  const Image a = picture(63, 70, 5), b = picture(63, 70, 6);
  const test::WeightsByName weights = by_name(state);
  PerceptualOracle oracle(weights);
  const double expected =
      PerceptualOracle::distance(oracle.squeeze10(PerceptualOracle::caffe_input(a)),
                                 oracle.squeeze10(PerceptualOracle::caffe_input(b)), {});
  EXPECT_GT(expected, 0.01);
  EXPECT_NEAR(distance.between(a, b), expected, 2e-5 * expected);
  EXPECT_EQ(distance.between(a, a), 0);
  EXPECT_DOUBLE_EQ(distance.between(a, b), distance.between(b, a));
  const Image small_a = picture(33, 32, 5), small_b = picture(33, 32, 6);
  const std::vector<Feature> of_b = oracle.squeeze10(PerceptualOracle::caffe_input(small_b));
  check_gradient(distance, small_a, small_b, [&](const Image& image) {
    return PerceptualOracle::distance(oracle.squeeze10(PerceptualOracle::caffe_input(image)), of_b,
                                      {});
  });
}

TEST(DeepCompression, HostileFiles) {
  // One layer of 2 x 1 x 1 x 3: weights 0 b2 0 0 b1 0.
  const std::vector<std::vector<int64_t>> shapes = {{2, 1, 1, 3}};
  std::vector<float> book(256, 0.0f), bias = {0.5f, -0.5f};
  book[1] = 7;
  book[2] = 9;
  const auto bytes = [&](uint32_t listed, const std::vector<uint8_t>& codes,
                         const std::vector<uint8_t>& gaps) {
    std::vector<uint8_t> file;
    const auto append = [&](const void* data, size_t size) {
      const auto* begin = static_cast<const uint8_t*>(data);
      file.insert(file.end(), begin, begin + size);
    };
    append(&listed, 4);
    append(book.data(), 1024);
    append(bias.data(), 8);
    append(codes.data(), codes.size());
    append(gaps.data(), gaps.size());
    return file;
  };
  const auto sound = bytes(2, {2, 1}, {0x21});
  const auto layers = parse_deep_compression(sound, shapes, "x.net");
  EXPECT_EQ(layers[0].weights, (std::vector<float>{0, 9, 0, 0, 7, 0}));
  EXPECT_EQ(layers[0].bias, bias);
  const auto refusal = [&](const std::vector<uint8_t>& file) {
    return error_of([&] { parse_deep_compression(file, shapes, "x.net"); });
  };
  for (size_t length = 0; length < sound.size(); ++length)
    EXPECT_TRUE(contains(refusal({sound.begin(), sound.begin() + static_cast<long>(length)}),
                         "x.net: not SqueezeNet"));
  EXPECT_TRUE(contains(refusal(bytes(2, {2, 1}, {0x21, 0})), "longer"));
  EXPECT_TRUE(contains(refusal(bytes(2, {2, 1}, {0x51})), "beyond its end"));
  EXPECT_TRUE(contains(refusal(bytes(7, {2, 1}, {0x21})), "more weights"));
  EXPECT_TRUE(contains(refusal(bytes(0xFFFFFFFF, {2, 1}, {0x21})), "more weights"));
  book[0] = 1;
  EXPECT_TRUE(contains(refusal(bytes(2, {2, 1}, {0x21})), "no zero"));
  book[0] = 0;
  bias[1] = NAN;
  EXPECT_TRUE(contains(refusal(bytes(2, {2, 1}, {0x21})), "not finite"));
}

// Each pass is a 3 x 3 box.
Image blurred(const Image& image, int passes) {
  Image from = image, to = image;
  for (int pass = 0; pass < passes; ++pass, std::swap(from, to))
    for (int y = 0; y < image.height; ++y)
      for (int x = 0; x < image.width; ++x)
        for (int c = 0; c < 3; ++c) {
          float sum = 0;
          for (int v = -1; v <= 1; ++v)
            for (int u = -1; u <= 1; ++u)
              sum += from.at(std::clamp(x + u, 0, image.width - 1),
                             std::clamp(y + v, 0, image.height - 1))[c];
          to.at(x, y)[c] = sum / 9;
        }
  return from;
}

TEST(FeatureSqueezenet10, TheRealNetworkGrowsWithBlurAndNoise) {
  const Path data = test::outside_data("EFFIGY_DATA");
  const Path file = data / "perceptual/squeezenet_v1.0_deep_compression.net";
  if (data.empty() || !std::filesystem::exists(file))
    GTEST_SKIP() << "set EFFIGY_DATA to a folder with perceptual/" << file.filename()
                 << " to run this";
  const auto bytes = read_file(file);
  ASSERT_EQ(bytes.size(), 675763u);
  // The published network, to the last byte: 732448 weights without the classifier, about a third
  // of them kept; every layer's bias in use.
  std::vector<std::vector<int64_t>> shapes;
  for (const LayerSize& layer : test::squeeze10_layers())
    shapes.push_back({layer.out, layer.in, layer.kernel, layer.kernel});
  const auto layers = parse_deep_compression(bytes, shapes, "net");
  ASSERT_EQ(layers.size(), 26u);
  size_t total = 0, kept = 0;
  for (size_t l = 0; l + 1 < layers.size(); ++l) {
    total += layers[l].weights.size();
    for (const float weight : layers[l].weights) kept += weight != 0;
  }
  EXPECT_EQ(total, 732448u);
  EXPECT_GT(kept, total / 5);
  EXPECT_LT(kept, total / 2);

  const PerceptualDistance distance = PerceptualDistance::squeezenet10(file);
  // Discs and stripes: something with edges.
  Image scene(128, 128, 3);
  for (int y = 0; y < 128; ++y)
    for (int x = 0; x < 128; ++x) {
      const bool disc = std::hypot(x - 60, y - 70) < 35, stripe = (x + 2 * y) / 12 % 2 == 0;
      scene.at(x, y)[0] = disc ? 0.8f : 0.2f;
      scene.at(x, y)[1] = disc ? 0.5f : (stripe ? 0.7f : 0.3f);
      scene.at(x, y)[2] = disc && stripe ? 0.2f : 0.4f;
    }
  EXPECT_EQ(distance.between(scene, scene), 0);
  double last = 0;
  for (const int passes : {1, 2, 4, 8, 16, 32}) {
    const double here = distance.between(scene, blurred(scene, passes));
    EXPECT_GT(here, 1.02 * last) << passes << " passes of blur";
    last = here;
  }
  last = 0;
  for (const double sigma : {0.01, 0.02, 0.05, 0.1, 0.2}) {
    Random random(11);
    Image noisy = scene;
    for (float& value : noisy.data)
      value = std::clamp(value + static_cast<float>(random.uniform(-1.7, 1.7) * sigma), 0.0f, 1.0f);
    const double here = distance.between(scene, noisy);
    EXPECT_GT(here, 1.02 * last) << "noise of " << sigma;
    last = here;
  }
}

}  // namespace
}  // namespace effigy
