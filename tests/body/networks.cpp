#include "effigy/body/networks.h"

#include <cmath>
#include <cstring>
#include <limits>

#include "effigy/base/random.h"
#include "effigy/base/threads.h"
#include "support.h"

namespace effigy {
namespace {

using test::contains;
using test::error_of;

BodyNetworkSettings tiny() {
  return BodyNetworkSettings::from_size("tiny", 5, 4);
}

std::vector<int32_t> every_third(int texture) {
  std::vector<int32_t> texels;
  for (int32_t i = 1; i < texture * texture; i += 3) texels.push_back(i);
  return texels;
}

std::vector<float> random_floats(size_t count, uint64_t stream) {
  Random random(17, stream);
  std::vector<float> values(count);
  for (float& value : values) value = static_cast<float>(random.normal());
  return values;
}

struct Inputs {
  std::vector<float> body = random_floats(15, 1), face = random_floats(12, 2), directions,
                     irradiance = random_floats(64 * 64, 4);
  explicit Inputs(size_t texels) : directions(random_floats(3 * texels, 3)) {}
};

struct Results {
  std::vector<float> gaussians, visibility, shadow;
  bool operator==(const Results&) const = default;
};

Results run(BodyNetworks& networks, const Inputs& in) {
  const auto copy = [](std::span<const float> values) {
    return std::vector<float>(values.begin(), values.end());
  };
  Results results;
  results.gaussians = copy(networks.decode(in.body, in.face));
  results.visibility = copy(networks.visibility(in.directions));
  results.shadow = copy(networks.shadow(in.irradiance));
  return results;
}

struct Step {
  Results results;
  std::vector<std::vector<float>> gradients;
  bool operator==(const Step&) const = default;
};

Step forward_backward(uint64_t seed) {
  BodyNetworks networks(tiny(), every_third(64), seed);
  networks.set_training(true);
  const size_t n = networks.texels().size();
  Step step;
  step.results = run(networks, Inputs(n));
  networks.backward(random_floats(65 * n, 5), random_floats(n, 6), random_floats(n, 7));
  for (const BodyParameter& p : networks.parameters())
    step.gradients.emplace_back(p.gradient.begin(), p.gradient.end());
  return step;
}

TEST(BodyNetworks, SameSeedSameBits) {
  const Step first = forward_backward(3);
  EXPECT_EQ(first, forward_backward(3));
  EXPECT_NE(first.results.gaussians, forward_backward(4).results.gaussians);
  EXPECT_EQ(first.results.gaussians.size(), 65 * every_third(64).size());
  for (const auto& gradient : first.gradients) EXPECT_FALSE(gradient.empty());
}

TEST(BodyNetworks, GradientsAddUpAndAreCleared) {
  BodyNetworks networks(tiny(), every_third(64), 3);
  networks.set_training(true);
  const size_t n = networks.texels().size();
  const Inputs in(n);
  const auto once = forward_backward(3).gradients;
  for (int i = 0; i < 2; ++i) {
    run(networks, in);
    networks.backward(random_floats(65 * n, 5), random_floats(n, 6), random_floats(n, 7));
  }
  auto parameters = networks.parameters();
  for (size_t p = 0; p < parameters.size(); ++p)
    for (size_t i = 0; i < once[p].size(); ++i)
      ASSERT_NEAR(parameters[p].gradient[i], 2 * once[p][i], 1e-5f * (1 + std::abs(once[p][i])))
          << parameters[p].name;
  networks.clear_gradients();
  for (const BodyParameter& p : networks.parameters()) EXPECT_TRUE(p.gradient.empty());
  // Only the shadow's gradient: nothing reaches the decoders.
  run(networks, in);
  networks.backward({}, {}, random_floats(n, 7));
  for (const BodyParameter& p : networks.parameters())
    EXPECT_EQ(p.gradient.empty(), p.name.rfind("shadow.", 0) != 0) << p.name;
}

// A step against the gradient lowers the loss by what the gradient promises.
TEST(BodyNetworks, ParametersMayBeChangedInPlace) {
  BodyNetworks networks(tiny(), every_third(64), 3);
  networks.set_training(true);
  const size_t n = networks.texels().size();
  const Inputs in(n);
  const auto a = random_floats(65 * n, 5), b = random_floats(n, 6), c = random_floats(n, 7);
  const auto loss = [&] {
    const Results r = run(networks, in);
    double sum = 0;
    for (size_t i = 0; i < a.size(); ++i) sum += static_cast<double>(a[i]) * r.gaussians[i];
    for (size_t i = 0; i < n; ++i)
      sum += static_cast<double>(b[i]) * r.visibility[i] + static_cast<double>(c[i]) * r.shadow[i];
    return sum;
  };
  const double before = loss();
  networks.backward(a, b, c);
  double square = 0;
  constexpr float kRate = 1e-7f;
  for (const BodyParameter& p : networks.parameters())
    for (size_t i = 0; i < p.value.size(); ++i) {
      square += static_cast<double>(p.gradient[i]) * p.gradient[i];
      p.value[i] -= kRate * p.gradient[i];
    }
  EXPECT_NEAR((before - loss()) / (kRate * square), 1.0, 0.1);
}

TEST(BodyNetworks, OnlyMeanDirectionsOfACellMatter) {
  BodyNetworks networks(tiny(), {0, 1, 64 * 64 - 1}, 3);
  const Inputs in(3);
  networks.decode(in.body, in.face);
  const std::vector<float> apart = {1, 0, 0, 0, 1, 0, 0, 0, 1};
  const std::vector<float> mean = {0.5f, 0.5f, 0, 0.5f, 0.5f, 0, 0, 0, 1};
  const auto first = networks.visibility(apart);
  const std::vector<float> kept(first.begin(), first.end());
  const auto second = networks.visibility(mean);
  EXPECT_TRUE(std::equal(kept.begin(), kept.end(), second.begin()));
  const auto third = networks.visibility(std::vector<float>{1, 0, 0, 1, 0, 0, 0, 0, 1});
  EXPECT_FALSE(std::equal(kept.begin(), kept.end(), third.begin()));
}

TEST(BodyNetworks, KeypointsAreScaled) {
  const std::vector<float> frames = {1, 2, 3, 3, 2, 5};
  const KeypointScale scale = keypoint_scale(frames, 1);
  EXPECT_EQ(scale.mean, (std::vector<float>{2, 2, 4}));
  EXPECT_NEAR(scale.deviation, std::sqrt(4.0f / 6.0f), 1e-6f);
  EXPECT_GT(keypoint_scale(std::vector<float>{1, 2, 3}, 1).deviation, 0.0f);

  BodyNetworks plain(tiny(), every_third(64), 3), scaled(tiny(), every_third(64), 3);
  const Inputs in(plain.texels().size());
  Inputs moved = in;
  for (float& value : moved.body) value = 3.0f + 2.0f * value;
  scaled.set_keypoint_scale({std::vector<float>(15, 3.0f), 2.0f}, {std::vector<float>(12), 1.0f});
  const auto a = run(plain, in).gaussians, b = run(scaled, moved).gaussians;
  for (size_t i = 0; i < a.size(); ++i) ASSERT_NEAR(a[i], b[i], 1e-5f);
  EXPECT_TRUE(contains(
      error_of([&] {
        scaled.set_keypoint_scale({std::vector<float>(15), 0.0f}, {std::vector<float>(12), 1.0f});
      }),
      "positive deviation"));
  Inputs broken = in;
  broken.face[7] = std::numeric_limits<float>::quiet_NaN();
  EXPECT_TRUE(contains(error_of([&] { plain.decode(broken.body, broken.face); }),
                       "face keypoint 2 is not finite"));
}

TEST(BodyNetworks, SavedAndLoadedBitForBit) {
  const test::ScratchFolder scratch;
  BodyNetworks networks(tiny(), every_third(64), 3);
  networks.set_keypoint_scale({random_floats(15, 8), 0.3f}, {random_floats(12, 9), 0.02f});
  networks.set_mean_irradiance(random_floats(64 * 64, 10));
  TensorFile file;
  networks.save(file);
  write_safetensors(scratch / "networks.safetensors", file);
  BodyNetworks loaded = BodyNetworks::load(read_safetensors(scratch / "networks.safetensors"));
  EXPECT_EQ(loaded.texels(), networks.texels());
  EXPECT_EQ(to_json(loaded.settings()), to_json(networks.settings()));
  const auto a = networks.parameters(), b = loaded.parameters();
  ASSERT_EQ(a.size(), b.size());
  for (size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(a[i].name, b[i].name);
    ASSERT_EQ(a[i].value.size(), b[i].value.size());
    EXPECT_EQ(std::memcmp(a[i].value.data(), b[i].value.data(), a[i].value.size_bytes()), 0);
  }
  const Inputs in(networks.texels().size());
  EXPECT_EQ(run(networks, in), run(loaded, in));
}

TEST(BodyNetworks, HostileFilesAreRefused) {
  const BodyNetworks networks(tiny(), every_third(64), 3);
  TensorFile good;
  networks.save(good);
  good.path = "avatar/networks.safetensors";
  const auto error = [&](auto&& damage) {
    TensorFile file = good;
    damage(file);
    const std::string sentence = error_of([&] { BodyNetworks::load(file); });
    EXPECT_EQ(sentence.rfind("avatar/networks.safetensors: ", 0), 0u) << sentence;
    return sentence;
  };
  const auto settings = [&](const char* field, const Json& value) {
    return error([&](TensorFile& file) {
      Json json = Json::parse(file.metadata["networks"]);
      json[field] = value;
      file.metadata["networks"] = json.dump();
    });
  };
  EXPECT_TRUE(contains(error([](TensorFile& f) { f.metadata.clear(); }), "metadata"));
  EXPECT_TRUE(contains(error([](TensorFile& f) { f.metadata["networks"] = "{"; }), "metadata"));
  EXPECT_TRUE(contains(settings("body_latent", "many"), "body_latent"));
  EXPECT_TRUE(contains(settings("body_latent", -1), "body_latent"));
  EXPECT_TRUE(contains(settings("decoder", Json::array({32, 1 << 30})), "decoder"));
  EXPECT_TRUE(contains(settings("shadow_side", 1 << 20), "shadow_side"));
  // Settings that ask for far more than the file holds are refused before memory is taken.
  EXPECT_TRUE(contains(settings("seed_channels", 4096), "seed"));
  EXPECT_TRUE(contains(settings("body_keypoints", 100000), "encoder.body.0"));
  EXPECT_TRUE(contains(error([](TensorFile& f) { f.tensors.erase("networks.shadow.out.v"); }),
                       "shadow.out.v"));
  EXPECT_TRUE(contains(error([](TensorFile& f) {
                         const float nan = std::numeric_limits<float>::quiet_NaN();
                         std::memcpy(f.tensors["networks.seed.0.v"].bytes.data(), &nan, 4);
                       }),
                       "not finite"));
  EXPECT_TRUE(contains(error([](TensorFile& f) {
                         f.tensors["networks.texels"] = Tensor::from(
                             std::span<const int32_t>(std::vector<int32_t>{4, 4}), {2});
                       }),
                       "valid texel 1"));
  EXPECT_TRUE(contains(error([](TensorFile& f) {
                         f.tensors["networks.texels"] = Tensor::from(
                             std::span<const int32_t>(std::vector<int32_t>{4096}), {1});
                       }),
                       "below 4096"));
  EXPECT_TRUE(contains(error([](TensorFile& f) {
                         f.tensors["networks.texels"] =
                             Tensor::from(std::span<const int32_t>(std::vector<int32_t>{}), {0});
                       }),
                       "no valid texels"));
  EXPECT_TRUE(contains(error([](TensorFile& f) {
                         f.tensors["networks.keypoints.face.deviation"] =
                             Tensor::from(std::span<const float>(std::vector<float>{0.0f}), {1});
                       }),
                       "positive deviation"));
}

}  // namespace
}  // namespace effigy
