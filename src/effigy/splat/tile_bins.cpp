#include "effigy/splat/tile_bins.h"

#include <atomic>
#include <string>

#include "effigy/base/error.h"
#include "effigy/splat/kernel_choice.h"

namespace effigy {
namespace {

constexpr int kLargestImage = 32768;

std::atomic<KernelChoice> g_choice{KernelChoice::kBest};

}  // namespace

void choose_splat_kernels(KernelChoice choice) {
  g_choice = choice;
}

KernelChoice splat_kernel_choice() {
  return g_choice;
}

void check_camera(const Camera& camera) {
  if (camera.width < 1 || camera.height < 1 || camera.width > kLargestImage ||
      camera.height > kLargestImage)
    throw Error("An image of " + std::to_string(camera.width) + " x " +
                std::to_string(camera.height) + " pixels cannot be drawn; each side must be 1 to " +
                std::to_string(kLargestImage) + ".");
  const bool sound = std::isfinite(camera.fx) && std::isfinite(camera.fy) && camera.fx != 0.0 &&
                     camera.fy != 0.0 && std::isfinite(camera.cx) && std::isfinite(camera.cy) &&
                     camera.camera_from_world_rotation.allFinite() &&
                     camera.camera_from_world_translation.allFinite();
  if (!sound)
    throw Error("The camera has a focal length of zero or a value that is not finite; check it.");
}

SplatTile make_tile(const Camera& camera, const TileBins& bins, int tile) {
  SplatTile t;
  t.x = tile % bins.columns * kTileSize;
  t.y = tile / bins.columns * kTileSize;
  t.width = std::min(kTileSize, camera.width - t.x);
  t.height = std::min(kTileSize, camera.height - t.y);
  const uint32_t begin = bins.begin[static_cast<size_t>(tile)];
  t.entries = bins.entries.data() + begin;
  t.count = bins.begin[static_cast<size_t>(tile) + 1] - begin;
  return t;
}

namespace detail {

// Calls body(span, entry, true) for the slot's entries in the order of its splats, and, since no
// branch asks whether there is a second column, body(span, some entry, false) where there is none.
// `next`: the next entry of each tile, left behind the last.
template <class Body>
void for_each_entry(const TileBins& bins, size_t slot, std::vector<uint32_t>& next,
                    const Body& body) {
  const TileSpans& spans = bins.spans[slot];
  for (size_t k = 0; k < spans.count; ++k) {
    const TileSpan span = spans.memory[k];
    uint32_t* row = next.data() + static_cast<size_t>(span.row) * static_cast<size_t>(bins.columns);
    body(span, row[span.first]++, true);
    for (int tx = span.first + 1; tx < span.last; ++tx) body(span, row[tx]++, true);
    const bool second = span.first != span.last;
    body(span, row[span.last], second);
    row[span.last] += second;
  }
}

void begin_bins(int width, int height, size_t slots, TileBins& bins) {
  bins.columns = (width + kTileSize - 1) / kTileSize;
  bins.rows = (height + kTileSize - 1) / kTileSize;
  bins.spans.resize(slots);
  bins.next.resize(slots);
  for (size_t s = 0; s < slots; ++s) {
    bins.spans[s].count = 0;
    bins.next[s].assign(static_cast<size_t>(bins.count()), 0);
  }
}

void finish_bins(const uint32_t* ids, TileBins& bins) {
  const size_t tiles = static_cast<size_t>(bins.count()), slots = bins.spans.size();
  bins.begin.resize(tiles + 1);
  uint64_t sum = 0;
  for (size_t t = 0; t < tiles; ++t) {
    bins.begin[t] = static_cast<uint32_t>(sum);
    for (size_t s = 0; s < slots; ++s) {
      const uint32_t share = bins.next[s][t];
      bins.next[s][t] = static_cast<uint32_t>(sum);
      sum += share;
    }
    if (sum > 0x7fffffffu)
      throw Error(
          "The splats cover more than two thousand million tiles in all; they are far too "
          "large for this image.");
  }
  bins.begin[tiles] = static_cast<uint32_t>(sum);
  bins.entries.resize(sum);
  bins.places.clear();
  run_slots(static_cast<int>(slots), [&](int slot) {
    const auto s = static_cast<size_t>(slot);
    uint32_t* const entries = bins.entries.data();
    uint32_t nowhere;
    for_each_entry(bins, s, bins.next[s], [&](const TileSpan& span, uint32_t entry, bool really) {
      *(really ? entries + entry : &nowhere) = ids ? ids[span.splat] : span.splat;
    });
  });
}

}  // namespace detail

void place_entries(size_t splats, TileBins& bins) {
  if (!bins.places.empty()) return;
  const size_t tiles = static_cast<size_t>(bins.count()), slots = bins.spans.size();
  // finish_bins has left each slot's counters behind its last entry, where the next slot's begin.
  std::vector<std::vector<uint32_t>> next(slots);
  std::vector<uint32_t> first(slots + 1, 0);  // place of each slot
  for (size_t s = 0; s < slots; ++s) {
    next[s].resize(tiles);
    first[s + 1] = first[s];
    for (size_t t = 0; t < tiles; ++t) {
      next[s][t] = s == 0 ? bins.begin[t] : bins.next[s - 1][t];
      first[s + 1] += bins.next[s][t] - next[s][t];
    }
  }
  bins.places.resize(bins.entries.size());
  bins.first_place.resize(splats + 1);
  run_slots(static_cast<int>(slots), [&](int slot) {
    const auto s = static_cast<size_t>(slot);
    uint32_t at = first[s];
    size_t splat = splats * s / slots;
    uint32_t* const places = bins.places.data();
    uint32_t nowhere;
    detail::for_each_entry(bins, s, next[s],
                           [&](const TileSpan& span, uint32_t entry, bool really) {
                             while (splat <= span.splat) bins.first_place[splat++] = at;
                             *(really ? places + entry : &nowhere) = at;
                             at += really;
                           });
    while (splat < splats * (s + 1) / slots) bins.first_place[splat++] = at;
  });
  bins.first_place[splats] = first[slots];
}

}  // namespace effigy
