#include "effigy/splat/gaussian_raster.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <string>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/splat/gaussian_kernels.h"
#include "effigy/splat/gaussian_prepare.h"
#include "effigy/splat/kernel_choice.h"

namespace effigy {
namespace {

constexpr int kMostChannels = 256;
constexpr size_t kMostGaussians = size_t{1} << 31;

void check_arguments(const Camera& camera, const GaussianView& g,
                     const GaussianRasterOptions& options) {
  const size_t n = g.count();
  EFFIGY_CHECK_EQ(g.center.size(), 3 * n);
  EFFIGY_CHECK_EQ(g.rotation.size(), 4 * n);
  EFFIGY_CHECK_EQ(g.scale.size(), 3 * n);
  if (g.channels < 1 || g.channels > kMostChannels)
    throw Error("Gaussians with " + std::to_string(g.channels) +
                " feature channels cannot be drawn; give 1 to " + std::to_string(kMostChannels) +
                ".");
  if (n >= kMostGaussians) throw Error("More than two thousand million Gaussians cannot be drawn.");
  EFFIGY_CHECK_EQ(g.features.size(), n * static_cast<size_t>(g.channels));
  EFFIGY_CHECK(options.background.empty() ||
               options.background.size() == static_cast<size_t>(g.channels));
  if (!(options.blur >= 0.0f && options.blur <= 1e6f))
    throw Error("The blur of the Gaussian rasterizer must be 0 or more squared pixels.");
  check_camera(camera);
}

GaussianKernels chosen_kernels() {
  return splat_kernel_choice() == KernelChoice::kScalar ? scalar_gaussian_kernels()
                                                        : best_gaussian_kernels();
}

}  // namespace

void Gaussians::resize(size_t count) {
  center.resize(3 * count);
  rotation.resize(4 * count);
  scale.resize(3 * count);
  opacity.resize(count);
  features.resize(count * static_cast<size_t>(channels));
}

GaussianView Gaussians::view() const {
  return {center, rotation, scale, opacity, features, channels};
}

struct GaussianFrame::State {
  GaussianList list;
  TileBins bins;
  std::vector<int64_t> tile_pairs;  // blended, of every tile
  std::vector<uint32_t> tile_used;  // entries walked until every pixel was finished
  std::vector<float> background;
  int64_t pairs = 0;
  std::vector<std::unique_ptr<GaussianWorkspace>> workspaces;  // one per slot
  std::vector<float> entry_sums;                               // backward

  void reserve(int slots) {
    while (workspaces.size() < static_cast<size_t>(slots))
      workspaces.push_back(std::make_unique<GaussianWorkspace>());
  }
  GaussianTarget scene(const GaussianView& g) const {
    GaussianTarget s;
    s.records = list.records.data();
    s.features = g.features.data();
    s.background = background.data();
    s.channels = static_cast<size_t>(g.channels);
    return s;
  }
  // Calls body(tile, workspace) for every tile. Tiles are independent, so taking the next one as it
  // comes does not change the result.
  template <class Body>
  void for_each_tile(const Body& body) {
    const int tiles = bins.count(), slots = std::min(thread_count(), tiles);
    reserve(slots);
    std::atomic<int> next{0};
    run_slots(slots, [&](int slot) {
      for (int t = next++; t < tiles; t = next++) body(t, *workspaces[static_cast<size_t>(slot)]);
    });
  }
};

GaussianFrame::GaussianFrame() : state(std::make_unique<State>()) {}
GaussianFrame::~GaussianFrame() = default;
GaussianFrame::GaussianFrame(GaussianFrame&&) noexcept = default;
GaussianFrame& GaussianFrame::operator=(GaussianFrame&&) noexcept = default;
int64_t GaussianFrame::pairs() const {
  return state->pairs;
}
size_t GaussianFrame::visible() const {
  return state->list.order.size();
}

void render_gaussians(const Camera& camera, const GaussianView& gaussians,
                      const GaussianRasterOptions& options, Planes& image, GaussianFrame& frame) {
  check_arguments(camera, gaussians, options);
  GaussianFrame::State& state = *frame.state;
  image.width = camera.width;
  image.height = camera.height;
  image.count = 1 + gaussians.channels;
  image.data.resize(image.pixels() * static_cast<size_t>(image.count));
  prepare_gaussians(camera, gaussians, options, state.list);
  const std::vector<GaussianRecord>& records = state.list.records;
  const std::vector<TileCover>& covers = state.list.covers;
  const std::vector<uint32_t>& order = state.list.order;
  bin_splats(order.size(), order.data(), camera.width, camera.height, state.bins,
             [&](size_t k, const auto& emit) {
               constexpr size_t kAhead = 16;
               if (k + kAhead < order.size()) __builtin_prefetch(&covers[order[k + kAhead]]);
               const TileCover& cover = covers[order[k]];
               if (cover.rows != TileCover::kMore) return cover.for_each_span(emit);
               const GaussianRecord& r = records[order[k]];
               for_each_span(r.anchor_x, r.anchor_y, r.outline, camera.width, camera.height, emit);
             });
  state.background = options.background;
  state.background.resize(static_cast<size_t>(gaussians.channels), 0.0f);
  GaussianTarget scene = state.scene(gaussians);
  scene.image = image.data.data();
  scene.plane_size = image.pixels();
  scene.row_size = static_cast<size_t>(image.width);
  const size_t tiles = static_cast<size_t>(state.bins.count());
  state.tile_pairs.assign(tiles, 0);
  state.tile_used.assign(tiles, 0);
  const GaussianKernels kernels = chosen_kernels();
  state.for_each_tile([&](int t, GaussianWorkspace& ws) {
    kernels.forward(scene, make_tile(camera, state.bins, t), ws);
    state.tile_pairs[static_cast<size_t>(t)] = ws.pairs;
    state.tile_used[static_cast<size_t>(t)] = static_cast<uint32_t>(ws.used);
  });
  state.pairs = 0;
  for (const int64_t p : state.tile_pairs) state.pairs += p;
}

void render_gaussians_backward(const Camera& camera, const GaussianView& gaussians,
                               const GaussianRasterOptions& options, const Planes& image,
                               const GaussianFrame& frame, const Planes& d_image,
                               const GaussianGradients& gradients) {
  check_arguments(camera, gaussians, options);
  GaussianFrame::State& state = *frame.state;
  const size_t channels = static_cast<size_t>(gaussians.channels);
  EFFIGY_CHECK_EQ(gradients.center.size(), gaussians.center.size());
  EFFIGY_CHECK_EQ(gradients.rotation.size(), gaussians.rotation.size());
  EFFIGY_CHECK_EQ(gradients.scale.size(), gaussians.scale.size());
  EFFIGY_CHECK_EQ(gradients.opacity.size(), gaussians.opacity.size());
  EFFIGY_CHECK_EQ(gradients.features.size(), gaussians.features.size());
  EFFIGY_CHECK(gradients.background.empty() || gradients.background.size() == channels);
  for (const Planes* p : {&image, &d_image}) {
    EFFIGY_CHECK_EQ(p->width, camera.width);
    EFFIGY_CHECK_EQ(p->height, camera.height);
    EFFIGY_CHECK_EQ(p->count, 1 + gaussians.channels);
  }
  EFFIGY_CHECK_EQ(state.list.records.size(), gaussians.count());
  GaussianTarget scene = state.scene(gaussians);
  scene.image = const_cast<float*>(image.data.data());  // read only
  scene.d_image = d_image.data.data();
  scene.plane_size = image.pixels();
  scene.row_size = static_cast<size_t>(image.width);
  const size_t stride = GaussianSums::kCount + channels;
  place_entries(state.list.order.size(), state.bins);
  state.entry_sums.resize(state.bins.entries.size() * stride);
  const bool wanted = !gradients.background.empty();
  std::vector<float> d_background(wanted ? static_cast<size_t>(state.bins.count()) * channels
                                         : size_t{0});
  const GaussianKernels kernels = chosen_kernels();
  state.for_each_tile([&](int t, GaussianWorkspace& ws) {
    SplatTile tile = make_tile(camera, state.bins, t);
    const uint32_t* places = state.bins.places.data() + state.bins.begin[static_cast<size_t>(t)];
    float* const sums = state.entry_sums.data();
    const size_t used = state.tile_used[static_cast<size_t>(t)];
    for (size_t e = used; e < tile.count; ++e) std::fill_n(sums + places[e] * stride, stride, 0.0f);
    tile.count = used;
    if (used == 0 && !wanted) return;
    kernels.backward(scene, tile, ws, places, sums,
                     wanted ? d_background.data() + static_cast<size_t>(t) * channels : nullptr);
  });
  gaussians_backward(camera, gaussians, options, state.list,
                     {state.bins, state.entry_sums.data(), stride}, gradients);
  for (size_t c = 0; wanted && c < channels; ++c) {
    double sum = 0.0;
    for (size_t i = c; i < d_background.size(); i += channels)
      sum += static_cast<double>(d_background[i]);
    gradients.background[c] += static_cast<float>(sum);
  }
}

}  // namespace effigy
