#include "effigy/splat/surfel_raster.h"

#include <sys/mman.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <string>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/splat/kernel_choice.h"
#include "effigy/splat/surfel_kernels.h"
#include "effigy/splat/surfel_prepare.h"
#include "effigy/splat/tile_bins.h"

namespace effigy {
namespace {

constexpr int kLargestTexture = 16384;
constexpr std::align_val_t kTexelAlignment{size_t{1} << 21};  // of a huge page

SurfelKernels chosen_kernels() {
  return splat_kernel_choice() == KernelChoice::kScalar ? scalar_surfel_kernels()
                                                        : best_surfel_kernels();
}

void check_texture(int width, int height) {
  if (width < 1 || height < 1 || width > kLargestTexture || height > kLargestTexture)
    throw Error("A texture of " + std::to_string(width) + " x " + std::to_string(height) +
                " texels cannot be used; each side must be 1 to " +
                std::to_string(kLargestTexture) + ".");
}

void check_texture(const MaterialTexture& texture) {
  check_texture(texture.width, texture.height);
  EFFIGY_CHECK_EQ(texture.texels.size(),
                  8 * static_cast<size_t>(texture.width) * static_cast<size_t>(texture.height));
}

void check_arguments(const Camera& camera, const PosedSurfels& s) {
  const size_t n = s.count();
  EFFIGY_CHECK_EQ(s.center.size(), 3 * n);
  EFFIGY_CHECK_EQ(s.s.size(), 3 * n);
  EFFIGY_CHECK_EQ(s.t.size(), 3 * n);
  EFFIGY_CHECK_EQ(s.uv.size(), 2 * n);
  EFFIGY_CHECK_EQ(s.uv_per_st.size(), 4 * n);
  EFFIGY_CHECK_EQ(s.frame.size(), 9 * n);
  check_camera(camera);
}

// The lists of the tiles.
void bin_surfels(const SurfelView& view, const Camera& camera, TileBins& bins) {
  bin_splats(view.records.size(), nullptr, camera.width, camera.height, bins,
             [&](size_t i, const auto& emit) {
               const SurfelRecord& r = view.records[i];
               for_each_span(r.anchor_x, r.anchor_y, view.outlines[i], camera.width, camera.height,
                             emit);
             });
}

// Tiles [begin[slot], begin[slot + 1]) of each slot, about the same cost each.
std::vector<int> split_tiles(const std::vector<int64_t>& cost, int slots) {
  int64_t total = 0;
  for (const int64_t c : cost) total += c;
  std::vector<int> begin{0};
  int64_t sum = 0;
  for (int tile = 0; tile < static_cast<int>(cost.size()); ++tile) {
    sum += cost[static_cast<size_t>(tile)];
    while (static_cast<int>(begin.size()) < slots &&
           sum * slots >= total * static_cast<int64_t>(begin.size()))
      begin.push_back(tile + 1);
  }
  begin.resize(static_cast<size_t>(slots) + 1, static_cast<int>(cost.size()));
  begin.back() = static_cast<int>(cost.size());
  return begin;
}

void resize_planes(Planes& planes, int width, int height, int count) {
  planes.width = width;
  planes.height = height;
  planes.count = count;
  planes.data.resize(planes.pixels() * static_cast<size_t>(count));
}

}  // namespace

PlaybackTexture::PlaybackTexture(const MaterialTexture& texture)
    : width_(texture.width), height_(texture.height) {
  check_texture(texture);
  const size_t count = texture.texels.size();
  texels_.reset(static_cast<uint16_t*>(::operator new(count * sizeof(uint16_t), kTexelAlignment)));
#ifdef MADV_HUGEPAGE
  // Lookups are scattered over the texture; failing costs only speed.
  ::madvise(texels_.get(), count * sizeof(uint16_t), MADV_HUGEPAGE);
#endif
  chosen_kernels().halve(texture.texels.data(), count, texels_.get());
}

void PlaybackTexture::Free::operator()(uint16_t* p) const {
  ::operator delete(p, kTexelAlignment);
}

struct SurfelFrame::State {
  SurfelView view;
  TileBins bins;
  std::vector<int64_t> tile_pairs;  // blended, of every tile
  std::vector<uint32_t> tile_used;  // entries walked until every pixel was finished
  int64_t pairs = 0;
  bool can_go_back = false;
  std::vector<std::unique_ptr<SurfelWorkspace>> workspaces;  // one per slot

  // Backward. Slot 0 adds to the caller's texels; the others have buffers that are all zero between
  // calls, so that only touched blocks are ever read or cleared.
  struct Buffers {
    std::vector<float> texels, sums;
    std::vector<uint8_t> touched;
  };
  std::vector<Buffers> buffers;

  void reserve(int slots) {
    while (workspaces.size() < static_cast<size_t>(slots))
      workspaces.push_back(std::make_unique<SurfelWorkspace>());
  }
};

SurfelFrame::SurfelFrame() : state(std::make_unique<State>()) {}
SurfelFrame::~SurfelFrame() = default;
SurfelFrame::SurfelFrame(SurfelFrame&&) noexcept = default;
SurfelFrame& SurfelFrame::operator=(SurfelFrame&&) noexcept = default;
int64_t SurfelFrame::pairs() const {
  return state->pairs;
}

namespace {

SurfelScene make_scene(const SurfelView& view, const MaterialTexture& texture,
                       const SurfelRasterOptions& options) {
  SurfelScene scene;
  scene.records = view.records.data();
  scene.outlines = view.outlines.data();
  scene.texels = texture.texels.data();
  scene.texture_width = texture.width;
  scene.texture_height = texture.height;
  scene.near = options.near;
  scene.low_pass = options.low_pass;
  scene.uv_distortion = options.uv_distortion;
  scene.uv_threshold = options.uv_distortion_threshold;
  return scene;
}

// Adds the buffers of slots 1.. to `texels` in order and clears what it read.
void reduce_texels(std::vector<SurfelFrame::State::Buffers>& buffers, int slots,
                   const MaterialTexture& texture, std::vector<float>& texels) {
  const size_t count = static_cast<size_t>(texture.width) * static_cast<size_t>(texture.height);
  const size_t blocks = (count + kTexelBlock - 1) / kTexelBlock;
  const size_t row = texture.height > 1 ? static_cast<size_t>(texture.width) : 0;
  for (int slot = 1; slot < slots; ++slot) {
    auto& b = buffers[static_cast<size_t>(slot)];
    // A tap's other three texels may lie in later blocks.
    std::vector<uint8_t> reach(blocks);
    for (size_t k = 0; k < blocks; ++k) {
      if (!b.touched[k]) continue;
      const size_t below = (k * kTexelBlock + row) / kTexelBlock;
      for (const size_t r : {k, k + 1, below, below + 1, below + 2})
        if (r < blocks) reach[r] = 1;
      b.touched[k] = 0;
    }
    parallel_for(blocks, 64, [&](size_t begin, size_t end, int) {
      for (size_t k = begin; k < end; ++k) {
        if (!reach[k]) continue;
        const size_t first = 8 * k * kTexelBlock, last = 8 * std::min(count, (k + 1) * kTexelBlock);
        float* to = texels.data();
        float* from = b.texels.data();
        for (size_t i = first; i < last; ++i) to[i] += from[i];
        std::memset(from + first, 0, sizeof(float) * (last - first));
      }
    });
  }
}

}  // namespace

namespace {

// Draws all tiles with one kind of kernel.
void draw_tiles(const Camera& camera, const SurfelScene& frame_scene,
                void (*kernel)(const SurfelScene&, const SplatTile&, SurfelWorkspace&),
                SurfelFrame::State& state, Planes& gbuffer) {
  SurfelScene scene = frame_scene;
  scene.gbuffer = gbuffer.data.data();
  scene.plane_size = gbuffer.pixels();
  scene.row_size = static_cast<size_t>(gbuffer.width);
  const int tiles = state.bins.count(), slots = std::min(thread_count(), tiles);
  state.tile_pairs.assign(static_cast<size_t>(tiles), 0);
  state.tile_used.assign(static_cast<size_t>(tiles), 0);
  state.reserve(slots);
  // Tiles are independent, so taking the next one as it comes does not change the result.
  std::atomic<int> next{0};
  run_slots(slots, [&](int slot) {
    SurfelWorkspace& ws = *state.workspaces[static_cast<size_t>(slot)];
    for (int t = next++; t < tiles; t = next++) {
      const SplatTile tile = make_tile(camera, state.bins, t);
      kernel(scene, tile, ws);
      state.tile_pairs[static_cast<size_t>(t)] = ws.pairs;
      state.tile_used[static_cast<size_t>(t)] = static_cast<uint32_t>(ws.used);
    }
  });
  state.pairs = 0;
  for (const int64_t p : state.tile_pairs) state.pairs += p;
}

// Whether some frame's normal is not the normal of its surfel.
bool has_own_normals(const SurfelView& view) {
  for (const SurfelRecord& r : view.records) {
    float difference = 0.0f;
    for (int k = 0; k < 3; ++k) difference += std::abs(r.normal[k] - r.frame[6 + k]);
    if (!(difference < 1e-4f)) return true;
  }
  return false;
}

}  // namespace

void render_surfels(const Camera& camera, const PosedSurfels& surfels,
                    const MaterialTexture& texture, const SurfelRasterOptions& options,
                    Planes& gbuffer, SurfelFrame& frame) {
  check_arguments(camera, surfels);
  check_texture(texture);
  SurfelFrame::State& state = *frame.state;
  resize_planes(gbuffer, camera.width, camera.height, kGBufferPlanes);
  prepare_surfels(camera, surfels, options.near, options.low_pass, state.view);
  bin_surfels(state.view, camera, state.bins);
  const SurfelScene scene = make_scene(state.view, texture, options);
  draw_tiles(camera, scene, chosen_kernels().forward, state, gbuffer);
  state.can_go_back = true;
}

void render_surfels_playback(const Camera& camera, const PosedSurfels& surfels,
                             const PlaybackTexture& texture, const PlaybackOptions& options,
                             Planes& gbuffer, SurfelFrame& frame) {
  check_arguments(camera, surfels);
  check_texture(texture.width(), texture.height());
  SurfelFrame::State& state = *frame.state;
  resize_planes(gbuffer, camera.width, camera.height, kGBufferPlanes);
  prepare_surfels(camera, surfels, options.near, options.low_pass, state.view);
  bin_surfels(state.view, camera, state.bins);
  SurfelScene scene;
  scene.records = state.view.records.data();
  scene.outlines = state.view.outlines.data();
  scene.half_texels = texture.texels();
  scene.texture_width = texture.width();
  scene.texture_height = texture.height();
  scene.near = options.near;
  scene.low_pass = options.low_pass;
  scene.spread = std::max(0.0f, options.spread_texels);
  scene.opaque = options.opaque;
  scene.only_shading = options.only_shading;
  scene.own_normals = !options.only_shading && has_own_normals(state.view);
  draw_tiles(camera, scene, chosen_kernels().playback, state, gbuffer);
  if (!options.only_shading) std::fill_n(gbuffer.plane(kUvDistortion), gbuffer.pixels(), 0.0f);
  state.can_go_back = false;
}

void render_surfels_backward(const Camera& camera, const PosedSurfels& surfels,
                             const MaterialTexture& texture, const SurfelRasterOptions& options,
                             const Planes& gbuffer, const SurfelFrame& frame,
                             const Planes& d_gbuffer, PosedSurfels& d_surfels,
                             std::vector<float>& d_texels) {
  check_arguments(camera, surfels);
  check_texture(texture);
  SurfelFrame::State& state = *frame.state;
  EFFIGY_CHECK(state.can_go_back);
  EFFIGY_CHECK_EQ(d_surfels.count(), surfels.count());
  EFFIGY_CHECK_EQ(d_texels.size(), texture.texels.size());
  for (const Planes* p : {&gbuffer, &d_gbuffer}) {
    EFFIGY_CHECK_EQ(p->width, camera.width);
    EFFIGY_CHECK_EQ(p->height, camera.height);
    EFFIGY_CHECK_EQ(p->count, static_cast<int>(kGBufferPlanes));
  }
  SurfelScene scene = make_scene(state.view, texture, options);
  scene.gbuffer = const_cast<float*>(gbuffer.data.data());  // read only
  scene.d_gbuffer = d_gbuffer.data.data();
  scene.plane_size = gbuffer.pixels();
  scene.row_size = static_cast<size_t>(gbuffer.width);
  const SurfelKernels kernels = chosen_kernels();
  const int tiles = state.bins.count(), slots = std::min(thread_count(), tiles);
  state.reserve(slots);
  if (state.buffers.size() < static_cast<size_t>(slots))
    state.buffers.resize(static_cast<size_t>(slots));
  const size_t records = state.view.records.size();
  const size_t blocks = texture.texels.size() / 8 / kTexelBlock + 1;
  std::vector<int64_t> cost(state.tile_pairs);
  for (int64_t& c : cost) c += 64;
  const std::vector<int> split = split_tiles(cost, slots);
  run_slots(slots, [&](int slot) {
    SurfelFrame::State::Buffers& b = state.buffers[static_cast<size_t>(slot)];
    b.sums.assign(records * SurfelSums::kCount, 0.0f);
    if (slot > 0 && b.texels.size() != d_texels.size()) b.texels.assign(d_texels.size(), 0.0f);
    if (b.touched.size() != blocks) b.touched.assign(blocks, 0);
    const SurfelGradientBuffers out{slot == 0 ? d_texels.data() : b.texels.data(), b.touched.data(),
                                    b.sums.data()};
    SurfelWorkspace& ws = *state.workspaces[static_cast<size_t>(slot)];
    for (int t = split[static_cast<size_t>(slot)]; t < split[static_cast<size_t>(slot) + 1]; ++t) {
      SplatTile tile = make_tile(camera, state.bins, t);
      tile.count = state.tile_used[static_cast<size_t>(t)];
      if (state.tile_pairs[static_cast<size_t>(t)] == 0) continue;
      kernels.backward(scene, tile, ws, out);
    }
  });
  reduce_texels(state.buffers, slots, texture, d_texels);
  parallel_for(records, 512, [&](size_t begin, size_t end, int) {
    for (size_t k = begin; k < end; ++k) {
      double sums[SurfelSums::kCount] = {};
      for (int slot = 0; slot < slots; ++slot) {
        const float* from =
            state.buffers[static_cast<size_t>(slot)].sums.data() + k * SurfelSums::kCount;
        for (int i = 0; i < SurfelSums::kCount; ++i) sums[i] += static_cast<double>(from[i]);
      }
      surfel_backward(camera, surfels, state.view.records[k], state.view.source[k], sums,
                      d_surfels);
    }
  });
}

}  // namespace effigy
