#include "effigy/body/network_modules.h"

#include <ATen/TensorOperators.h>
#include <ATen/ops/from_blob.h>
#include <torch/csrc/autograd/autograd.h>

#include <cmath>
#include <map>

#include "effigy/base/random.h"
#include "effigy/body/gaussian_channels.h"
#include "support.h"

namespace effigy {
namespace {

at::Tensor random_tensor(std::vector<int64_t> shape, uint64_t stream,
                         at::ScalarType type = at::ScalarType::Double) {
  Random random(11, stream);
  int64_t count = 1;
  for (int64_t side : shape) count *= side;
  std::vector<double> values(static_cast<size_t>(count));
  for (double& value : values) value = random.normal();
  return at::from_blob(values.data(), shape, at::ScalarType::Double).to(type).clone();
}

struct Counts {
  int64_t weights = 0, biases = 0;
};

std::map<std::string, Counts> counts_of(const BodyNetworkSettings& settings) {
  std::map<std::string, Counts> counts;
  for (const BodyModuleCount& c : count_body_parameters(settings))
    counts[c.module] = {c.weights, c.biases};
  return counts;
}

// Weights with their gains, by hand from the layers' sides.
int64_t decoder_weights(int64_t in, std::vector<int> widths, int64_t out) {
  int64_t total = 0;
  widths.push_back(static_cast<int>(out));
  for (int width : widths) {
    total += in * width * 16 + width;
    in = width;
  }
  return total;
}
int64_t decoder_biases(std::vector<int> widths, int64_t out) {
  int64_t total = 0, side = 16;
  widths.push_back(static_cast<int>(out));
  for (int width : widths) {
    total += side * side * width;
    side *= 2;
  }
  return total;
}

TEST(BodyModules, CountsOfEachSize) {
  struct Expected {
    const char* size;
    int texture;
    double decoder_weights, decoder_biases;  // D_ci, two digits
    int64_t shadow_weights, shadow_biases;
  };
  // The U-Net: 10 w^2 9 + 2 w 9 weights, 11 gains of w but the last's 1; 2 w biases a pixel of the
  // four levels, 1 for the last.
  const auto shadow_weights = [](int64_t w) { return 90 * w * w + 18 * w + 8 * w + 1; };
  const auto shadow_biases = [](int64_t w, int64_t side) {
    return 2 * w * (side * side + side * side / 4 + side * side / 16 + side * side / 64) + 1;
  };
  const Expected all[] = {
      {"tiny", 64, 66e3, 0.31e6, shadow_weights(4), shadow_biases(4, 64)},
      {"small", 256, 0.52e6, 5.1e6, shadow_weights(8), shadow_biases(8, 128)},
      {"full", 1024, 2.0e6, 76e6, shadow_weights(16), shadow_biases(16, 256)},
  };
  for (const Expected& e : all) {
    const auto settings = BodyNetworkSettings::from_size(e.size, 70, 60);
    auto counts = counts_of(settings);
    EXPECT_EQ(settings.texture(), e.texture);
    EXPECT_NEAR(static_cast<double>(counts["view_independent"].weights) / e.decoder_weights, 1.0,
                0.02);
    EXPECT_NEAR(static_cast<double>(counts["view_independent"].biases) / e.decoder_biases, 1.0,
                0.02);
    EXPECT_EQ(counts["view_independent"].weights,
              decoder_weights(settings.seed_channels, settings.decoder, 65));
    EXPECT_EQ(counts["view_independent"].biases, decoder_biases(settings.decoder, 65));
    EXPECT_EQ(counts["view_dependent"].weights,
              decoder_weights(settings.seed_channels + 8, settings.decoder, 1) + 3 * 8 + 8);
    EXPECT_EQ(counts["view_dependent"].biases, decoder_biases(settings.decoder, 1) + 8);
    EXPECT_EQ(counts["shadow"].weights, e.shadow_weights);
    EXPECT_EQ(counts["shadow"].biases, e.shadow_biases);
    int64_t total = 0;
    std::string line = std::string(e.size) + ":";
    for (const auto& [module, c] : counts) {
      total += c.weights + c.biases;
      line += " " + module + " " + std::to_string(c.weights) + " + " + std::to_string(c.biases);
    }
    std::printf("%s, together %lld\n", line.c_str(), static_cast<long long>(total));
    auto tied = settings;
    tied.tied_last = true;
    auto fewer = counts_of(tied);
    const int64_t texels = int64_t{e.texture} * e.texture;
    EXPECT_EQ(counts["view_independent"].biases - fewer["view_independent"].biases,
              65 * (texels - 1));
    EXPECT_EQ(counts["view_dependent"].biases - fewer["view_dependent"].biases, texels - 1);
  }
  // body-avatars' arithmetic for the shadow network at 256^2.
  EXPECT_EQ(shadow_biases(64, 256), 11141121);
}

BodyNetworkSettings small_enough_for_differences() {
  BodyNetworkSettings s;
  s.size = "test";
  s.body_keypoints = 3;
  s.face_keypoints = 2;
  s.body_hidden = {4, 5};
  s.face_hidden = {3};
  s.body_latent = 3;
  s.face_latent = 2;
  s.seed_channels = 3;
  s.decoder = {4};
  s.shadow_side = 16;
  s.shadow_width = 2;
  s.check("test");
  return s;
}

struct Inputs {
  at::Tensor body, face, view, irradiance;
  Inputs(const BodyNetworkSettings& s, at::ScalarType type)
      : body(random_tensor({1, 3 * s.body_keypoints}, 1, type)),
        face(random_tensor({1, 3 * s.face_keypoints}, 2, type)),
        view(random_tensor({8, 8, 3}, 3, type)),
        irradiance(random_tensor({s.shadow_side, s.shadow_side, 1}, 4, type)) {}
};

struct Outputs {
  at::Tensor gaussians, visibility, shadow;
  Outputs(const BodyModules& modules, const Inputs& in) {
    const at::Tensor seed = modules.seed(modules.encode(in.body, in.face));
    gaussians = modules.decode(seed);
    visibility = modules.visibility(seed, in.view);
    shadow = modules.shadow(in.irradiance);
  }
};

TEST(BodyModules, ShapesAndRanges) {
  for (const char* size : {"tiny", "small"}) {
    const auto settings = BodyNetworkSettings::from_size(size, 20, 30);
    ParameterMaker make = ParameterMaker::initial(1, at::ScalarType::Float);
    const BodyModules modules(settings, make);
    const Inputs in(settings, at::ScalarType::Float);
    const at::Tensor latents = modules.encode(in.body, in.face);
    EXPECT_EQ(latents.sizes().vec(),
              (std::vector<int64_t>{1, settings.body_latent + settings.face_latent}));
    EXPECT_EQ(modules.seed(latents).sizes().vec(),
              (std::vector<int64_t>{8, 8, settings.seed_channels}));
    // Inputs far out, so that the sigmoids are driven to their ends.
    for (const double far : {1.0, 100.0}) {
      Inputs scaled = in;
      scaled.body = in.body * far;
      scaled.irradiance = in.irradiance * far;
      const Outputs out(modules, scaled);
      const int64_t side = settings.texture();
      EXPECT_EQ(out.gaussians.sizes().vec(), (std::vector<int64_t>{side, side, 65}));
      EXPECT_EQ(out.visibility.sizes().vec(), (std::vector<int64_t>{side, side, 1}));
      EXPECT_EQ(out.shadow.sizes().vec(), (std::vector<int64_t>{side, side, 1}));
      EXPECT_TRUE(out.gaussians.isfinite().all().item<bool>());
      for (const at::Tensor& map : {out.visibility, out.shadow}) {
        EXPECT_GE(map.min().item<float>(), 0.0f);
        EXPECT_LE(map.max().item<float>(), 1.0f + 1e-6f);  // resizing rounds
        EXPECT_GT(map.max().item<float>(), map.min().item<float>());
      }
    }
    const Outputs out(modules, in);
    // Untrained: dull, lit, and small deviations from the activations' offsets.
    EXPECT_NEAR(out.visibility.mean().item<float>(), 0.1f, 0.02f);
    EXPECT_GT(out.shadow.mean().item<float>(), 0.5f);
    EXPECT_LT(out.gaussians.abs().max().item<float>(), 1.0f);
    EXPECT_GT(out.gaussians.abs().max().item<float>(), 1e-3f);
  }
}

// Every array of parameters against central differences, in double precision.
TEST(BodyModules, GradientOfEveryParameterGroup) {
  const auto settings = small_enough_for_differences();
  ParameterMaker make = ParameterMaker::initial(2, at::ScalarType::Double);
  const BodyModules modules(settings, make);
  uint64_t stream = 100;
  // Biases off zero, so that untied ones are told from tied ones.
  for (Parameter& p : make.parameters())
    if (p.name.ends_with(".bias")) p.value.detach().copy_(0.3 * random_tensor(p.shape, ++stream));
  const Inputs in(settings, at::ScalarType::Double);
  const at::Tensor a = random_tensor({32, 32, 65}, 5), b = random_tensor({32, 32, 1}, 6),
                   c = random_tensor({32, 32, 1}, 7);
  const auto loss = [&] {
    const Outputs out(modules, in);
    return (out.gaussians * a).sum() + (out.visibility * b).sum() + (out.shadow * c).sum();
  };
  loss().backward();
  Random random(13, 1);
  constexpr double kStep = 1e-5;
  for (Parameter& p : make.parameters()) {
    ASSERT_TRUE(p.value.grad().defined()) << p.name;
    double* values = p.value.data_ptr<double>();
    const double* gradient = p.value.grad().contiguous().data_ptr<double>();
    double largest = 0;
    for (int64_t i = 0; i < p.count(); ++i) largest = std::max(largest, std::abs(gradient[i]));
    EXPECT_GT(largest, 0.0) << p.name;
    for (int trial = 0; trial < 4; ++trial) {
      const auto i = static_cast<int64_t>(random.below(static_cast<uint64_t>(p.count())));
      const double kept = values[i];
      values[i] = kept + kStep;
      const double above = loss().item<double>();
      values[i] = kept - kStep;
      const double below = loss().item<double>();
      values[i] = kept;
      EXPECT_NEAR((above - below) / (2 * kStep), gradient[i], 1e-5 * largest + 1e-7)
          << p.name << " " << i;
    }
  }
}

// A texel's own bias changes that texel alone; a keypoint changes many.
TEST(BodyModules, UntiedBiasIsLocal) {
  const auto settings = small_enough_for_differences();
  ParameterMaker make = ParameterMaker::initial(2, at::ScalarType::Double);
  const BodyModules modules(settings, make);
  Inputs in(settings, at::ScalarType::Double);
  const at::Tensor before = Outputs(modules, in).gaussians.detach().clone();
  for (Parameter& p : make.parameters())
    if (p.name == "view_independent.1.bias") p.value.data_ptr<double>()[(5 * 32 + 7) * 65 + 9] = 2;
  const at::Tensor change = Outputs(modules, in).gaussians.detach() - before;
  EXPECT_NEAR(change[5][7][9].item<double>(), 2.0, 1e-12);
  EXPECT_EQ((change != 0).sum().item<int64_t>(), 1);
  in.body[0][0] += 1.0;
  EXPECT_GT((Outputs(modules, in).gaussians - before != 0).sum().item<int64_t>(), 32 * 32 * 32);
}

TEST(BodyModules, SettingsAreChecked) {
  EXPECT_TRUE(test::contains(test::error_of([] { BodyNetworkSettings::from_size("huge", 1, 1); }),
                             "tiny, small or full"));
  EXPECT_TRUE(test::contains(test::error_of([] { BodyNetworkSettings::from_size("tiny", 0, 1); }),
                             "body_keypoints"));
  auto settings = BodyNetworkSettings::from_size("tiny", 1, 1);
  settings.shadow_side = 20;
  EXPECT_TRUE(test::contains(test::error_of([&] { settings.check("x"); }), "shadow_side"));
  settings = BodyNetworkSettings::from_size("tiny", 1, 1);
  settings.decoder = {3, 0};
  EXPECT_TRUE(test::contains(test::error_of([&] { settings.check("x"); }), "decoder"));
}

}  // namespace
}  // namespace effigy
