#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <mutex>

#include "effigy/base/error.h"
#include "effigy/base/simd.h"
#include "effigy/base/threads.h"
#include "effigy/light/environment.h"
#include "effigy/light/prefilter_rows.h"

// The operator is W P: P builds the flux pyramid of the source, W has one sparse row per output
// texel over pyramid nodes (prefilter_rows.h). The cube has 48 symmetries (signed permutations of
// the axes), and the row of a mirrored output texel is the mirrored row; so rows exist only for the
// output texels of one eighth of one face, and are applied to permuted copies of the pyramid. Eight
// symmetries at a time stand side by side in a node (24 floats: 8 red, 8 green, 8 blue), so a
// weight is loaded once for 24 products.

namespace effigy {
namespace {

using F4 = float __attribute__((vector_size(16)));

F4 splat(float x) {
  return F4{x, x, x, x};
}

constexpr size_t kBatch = 8;  // symmetries at a time
constexpr size_t kBatches = 48 / kBatch;
constexpr size_t kLanes = 3 * kBatch;  // floats of a node of a batch

// sum[24] = sum of weights times nodes of a batch.
EFFIGY_CLONES void apply_row(const uint32_t* group, const float* weight, size_t groups,
                             const float* nodes, float* sum) {
  using F8 = float __attribute__((vector_size(32), aligned(4), may_alias));
  F8 r0 = {}, g0 = {}, b0 = {}, r1 = {}, g1 = {}, b1 = {}, r2 = {}, g2 = {}, b2 = {}, r3 = {},
     g3 = {}, b3 = {};
  for (size_t i = 0; i < groups; ++i) {
    const F8* node = reinterpret_cast<const F8*>(nodes + kLanes * group[i]);
    const float* w = weight + 4 * i;
    r0 += w[0] * node[0];
    g0 += w[0] * node[1];
    b0 += w[0] * node[2];
    r1 += w[1] * node[3];
    g1 += w[1] * node[4];
    b1 += w[1] * node[5];
    r2 += w[2] * node[6];
    g2 += w[2] * node[7];
    b2 += w[2] * node[8];
    r3 += w[3] * node[9];
    g3 += w[3] * node[10];
    b3 += w[3] * node[11];
  }
  F8* out = reinterpret_cast<F8*>(sum);
  out[0] = (r0 + r1) + (r2 + r3);
  out[1] = (g0 + g1) + (g2 + g3);
  out[2] = (b0 + b1) + (b2 + b3);
}

EFFIGY_CLONES void apply_row_transposed(const uint32_t* group, const float* weight, size_t groups,
                                        const float* value, float* nodes) {
  using F8 = float __attribute__((vector_size(32), aligned(4), may_alias));
  const F8* in = reinterpret_cast<const F8*>(value);
  const F8 r = in[0], g = in[1], b = in[2];
  for (size_t i = 0; i < groups; ++i) {
    F8* node = reinterpret_cast<F8*>(nodes + kLanes * group[i]);
    const float* w = weight + 4 * i;
    for (size_t k = 0; k < 4; ++k) {
      node[3 * k] += w[k] * r;
      node[3 * k + 1] += w[k] * g;
      node[3 * k + 2] += w[k] * b;
    }
  }
}

// How a symmetry moves the nodes of one face: to `face`, with the Z-order index's x and y bits
// swapped and flipped.
struct FaceMove {
  int face;
  bool swap;
  uint32_t flip;  // 0x55555555 for x, 0xaaaaaaaa for y, after swapping
  uint32_t operator()(uint32_t z_index, uint32_t mask) const {
    if (swap) z_index = ((z_index & 0x55555555u) << 1) | ((z_index >> 1) & 0x55555555u);
    return z_index ^ (flip & mask);
  }
};
using Symmetry = std::array<FaceMove, 6>;

Symmetry make_symmetry(const Mat3d& matrix) {
  Symmetry symmetry;
  for (int face = 0; face < 6; ++face) {
    const CubeFace& from = cube_face(face);
    FaceMove& move = symmetry[static_cast<size_t>(face)];
    move.face = cube_point(matrix * from.normal).face;
    const CubeFace& to = cube_face(move.face);
    const Vec3d s = matrix * from.s, t = matrix * from.t;
    move.swap = std::abs(s.dot(to.s)) < 0.5;
    const double along_x = move.swap ? t.dot(to.s) : s.dot(to.s);
    const double along_y = move.swap ? s.dot(to.t) : t.dot(to.t);
    move.flip = (along_x < 0 ? 0x55555555u : 0u) | (along_y < 0 ? 0xaaaaaaaau : 0u);
  }
  return symmetry;
}

// All 48 symmetries. The diagonal of the eighth of a face that rows are built for is mapped twice
// to the same texels; `first` marks the symmetry that may write it.
struct Symmetries {
  std::array<Mat3d, 48> matrix;
  std::array<Symmetry, 48> move;
  std::array<bool, 48> first;
  Symmetries() {
    constexpr int kOrder[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
    for (size_t i = 0; i < 48; ++i) {
      matrix[i].setZero();
      for (int row = 0; row < 3; ++row)
        matrix[i](row, kOrder[i / 8][row]) = (i >> row) & 1 ? -1.0 : 1.0;
      move[i] = make_symmetry(matrix[i]);
      // Exchanging y and z of the source fixes the diagonal: of each such pair one is proper.
      first[i] = matrix[i].determinant() > 0;
    }
  }
};

const Symmetries& symmetries() {
  static const Symmetries all;
  return all;
}

// Calls use(node, moved[8]) for all pyramid nodes: where the symmetries of a batch move a node.
template <typename Use>
void for_moved_nodes(const FluxPyramid& p, size_t batch, const Use& use) {
  const Symmetry* move = &symmetries().move[batch * kBatch];
  constexpr uint32_t kChunk = 64;
  uint32_t moved[kBatch][kChunk];
  for (int level = p.coarsest; level <= p.depth; ++level) {
    const uint32_t count = 1u << (2 * level), mask = count - 1;
    for (size_t face = 0; face < 6; ++face) {
      const size_t from = p.offset[level] + face * count;
      for (uint32_t begin = 0; begin < count; begin += kChunk) {
        const uint32_t chunk = std::min(kChunk, count - begin);
        for (size_t k = 0; k < kBatch; ++k) {
          const FaceMove m = move[k][face];
          const uint32_t to =
              static_cast<uint32_t>(p.offset[level]) + static_cast<uint32_t>(m.face) * count;
          for (uint32_t i = 0; i < chunk; ++i) moved[k][i] = to + m(begin + i, mask);
        }
        for (uint32_t i = 0; i < chunk; ++i) {
          std::array<uint32_t, kBatch> nodes;
          for (size_t k = 0; k < kBatch; ++k) nodes[k] = moved[k][i];
          use(from + begin + i, nodes);
        }
      }
    }
  }
}

// Four RGBA vectors <-> their red, green, blue (and alpha) as vectors.
inline void transpose(F4& a, F4& b, F4& c, F4& d) {
  const F4 ab0 = __builtin_shufflevector(a, b, 0, 4, 1, 5);
  const F4 ab1 = __builtin_shufflevector(a, b, 2, 6, 3, 7);
  const F4 cd0 = __builtin_shufflevector(c, d, 0, 4, 1, 5);
  const F4 cd1 = __builtin_shufflevector(c, d, 2, 6, 3, 7);
  a = __builtin_shufflevector(ab0, cd0, 0, 1, 4, 5);
  b = __builtin_shufflevector(ab0, cd0, 2, 3, 6, 7);
  c = __builtin_shufflevector(ab1, cd1, 0, 1, 4, 5);
  d = __builtin_shufflevector(ab1, cd1, 2, 3, 6, 7);
}

using F4u = float __attribute__((vector_size(16), aligned(4), may_alias));

// The pyramid seen through the symmetries of a batch, and the transpose of that.
void gather_batch(const FluxPyramid& p, size_t batch, const F4* nodes, float* moved) {
  for_moved_nodes(p, batch, [&](size_t node, const std::array<uint32_t, kBatch>& to) {
    for (size_t half = 0; half < kBatch; half += 4) {
      F4 a = nodes[to[half]], b = nodes[to[half + 1]], c = nodes[to[half + 2]],
         d = nodes[to[half + 3]];
      transpose(a, b, c, d);
      float* out = moved + kLanes * node + half;
      *reinterpret_cast<F4u*>(out) = a;
      *reinterpret_cast<F4u*>(out + kBatch) = b;
      *reinterpret_cast<F4u*>(out + 2 * kBatch) = c;
    }
  });
}

void scatter_batch(const FluxPyramid& p, size_t batch, const float* moved, F4* nodes) {
  for_moved_nodes(p, batch, [&](size_t node, const std::array<uint32_t, kBatch>& to) {
    for (size_t half = 0; half < kBatch; half += 4) {
      const float* in = moved + kLanes * node + half;
      F4 a = *reinterpret_cast<const F4u*>(in), b = *reinterpret_cast<const F4u*>(in + kBatch),
         c = *reinterpret_cast<const F4u*>(in + 2 * kBatch), d = splat(0);
      transpose(a, b, c, d);
      nodes[to[half]] += a;
      nodes[to[half + 1]] += b;
      nodes[to[half + 2]] += c;
      nodes[to[half + 3]] += d;
    }
  });
}

// Rows of one output cubemap: for texels of +x whose direction (1, a, b) has a >= b > 0.
struct OutputLevel {
  int size = 0;
  float roughness = 0.0f;
  struct Output {
    uint32_t first_group, groups;
    std::array<uint32_t, 48> texel;  // under each symmetry; kNone: another symmetry writes it
  };
  static constexpr uint32_t kNone = ~uint32_t{0};
  std::vector<Output> outputs;
  PrefilterRows rows;
};

uint32_t texel_index(const Vec3d& direction, int n) {
  const CubePoint p = cube_point(direction);
  const int x = static_cast<int>((p.s + 1.0) * 0.5 * n);
  const int y = static_cast<int>((p.t + 1.0) * 0.5 * n);
  return static_cast<uint32_t>((p.face * n + y) * n + x);
}

}  // namespace

struct Prefilter::State {
  FluxPyramid pyramid;
  std::vector<OutputLevel> levels;  // specular without level 0, then diffuse

  explicit State(int n);
  static Cubemap& map(PrefilteredEnvironment& e, size_t level) {
    return level + 1 < e.specular.size() ? e.specular[level + 1] : e.diffuse;
  }
  static const Cubemap& map(const PrefilteredEnvironment& e, size_t level) {
    return level + 1 < e.specular.size() ? e.specular[level + 1] : e.diffuse;
  }
};

Prefilter::State::State(int n) : pyramid(n) {
  const auto lobe_size = [n](double alpha, int least) {
    int size = least;
    while (size < 2.44 / alpha) size *= 2;
    return std::min(size, n);
  };
  const bool large = n > 32;
  std::vector<double> roughness = {0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0};
  if (large) roughness.insert(roughness.begin(), {0.1, 0.14});
  levels.resize(roughness.size() + 1);
  for (size_t i = 0; i < roughness.size(); ++i) {
    const double r = roughness[i];
    levels[i].roughness = static_cast<float>(r);
    levels[i].size = lobe_size(r * r, large || r < 0.7 ? 16 : 8);
  }
  levels.back().roughness = 1.0f;  // diffuse: the cosine lobe is that of alpha = 1
  levels.back().size = std::min(16, n);
  const Symmetries& all = symmetries();
  parallel_for(levels.size(), 1, [&](size_t begin, size_t end, int) {
    for (size_t i = begin; i < end; ++i) {
      OutputLevel& level = levels[i];
      const double r = level.roughness;
      RowBuilder builder(pyramid, r * r);
      const int m = level.size;
      for (int b = m / 2; b < m; ++b) {
        for (int a = b; a < m; ++a) {
          const Vec3d d(1.0, -1.0 + (2.0 * a + 1.0) / m, -1.0 + (2.0 * b + 1.0) / m);
          const uint32_t first = static_cast<uint32_t>(level.rows.group.size());
          builder.append(d.normalized().cast<float>(), level.rows);
          OutputLevel::Output& output = level.outputs.emplace_back();
          output.first_group = first;
          output.groups = static_cast<uint32_t>(level.rows.group.size()) - first;
          for (size_t k = 0; k < 48; ++k)
            output.texel[k] =
                a == b && !all.first[k] ? OutputLevel::kNone : texel_index(all.matrix[k] * d, m);
        }
      }
    }
  });
}

Prefilter::Prefilter(int source_size) {
  EFFIGY_CHECK(source_size >= 2 && source_size <= 1024 && (source_size & (source_size - 1)) == 0);
  static std::mutex mutex;
  static std::map<int, std::shared_ptr<const State>> cache;
  {
    const std::lock_guard lock(mutex);
    if (const auto found = cache.find(source_size); found != cache.end()) state_ = found->second;
  }
  if (state_) return;
  // Built outside the lock: building runs in the thread pool, whose threads may want the lock too.
  std::shared_ptr<const State> built = std::make_shared<State>(source_size);
  const std::lock_guard lock(mutex);
  state_ = cache.emplace(source_size, std::move(built)).first->second;
}

Prefilter::~Prefilter() = default;

PrefilteredEnvironment Prefilter::zero_like() const {
  PrefilteredEnvironment out;
  out.roughness.push_back(0.0f);
  out.specular.emplace_back(state_->pyramid.size);
  for (size_t i = 0; i + 1 < state_->levels.size(); ++i) {
    out.roughness.push_back(state_->levels[i].roughness);
    out.specular.emplace_back(state_->levels[i].size);
  }
  out.diffuse = Cubemap(state_->levels.back().size);
  return out;
}

PrefilteredEnvironment Prefilter::forward(const Cubemap& radiance) const {
  const State& state = *state_;
  const FluxPyramid& p = state.pyramid;
  EFFIGY_CHECK_EQ(radiance.size, p.size);
  std::vector<F4> nodes(p.nodes());
  const size_t base = p.offset[p.depth];
  for (size_t i = 0; i < p.source_texel.size(); ++i) {
    const float* c = &radiance.texels[3 * size_t{p.source_texel[i]}];
    nodes[base + i] = splat(p.solid_angle[base + i]) * F4{c[0], c[1], c[2], 0.0f};
  }
  for (int level = p.depth - 1; level >= p.coarsest; --level) {
    for (size_t i = p.offset[level + 1]; i < p.offset[level + 2]; ++i)
      for (const FluxPyramid::Parent& parent : p.parents[i])
        nodes[parent.node] += splat(parent.weight) * nodes[i];
  }
  PrefilteredEnvironment out = zero_like();
  out.specular[0].texels = radiance.texels;
  parallel_for(kBatches, 1, [&](size_t begin, size_t end, int) {
    std::vector<float> moved(kLanes * p.nodes());
    for (size_t batch = begin; batch < end; ++batch) {
      gather_batch(p, batch, nodes.data(), moved.data());
      for (size_t i = 0; i < state.levels.size(); ++i) {
        const PrefilterRows& rows = state.levels[i].rows;
        float* texels = State::map(out, i).texels.data();
        for (const OutputLevel::Output& output : state.levels[i].outputs) {
          float value[kLanes];
          apply_row(&rows.group[output.first_group], &rows.weight[4 * size_t{output.first_group}],
                    output.groups, moved.data(), value);
          for (size_t k = 0; k < kBatch; ++k) {
            const uint32_t texel = output.texel[batch * kBatch + k];
            if (texel == OutputLevel::kNone) continue;
            for (size_t c = 0; c < 3; ++c) texels[3 * size_t{texel} + c] = value[c * kBatch + k];
          }
        }
      }
    }
  });
  return out;
}

void Prefilter::backward(const PrefilteredEnvironment& gradient, Cubemap& d_radiance) const {
  const State& state = *state_;
  const FluxPyramid& p = state.pyramid;
  EFFIGY_CHECK_EQ(d_radiance.size, p.size);
  EFFIGY_CHECK_EQ(gradient.specular.size(), state.levels.size());
  EFFIGY_CHECK_EQ(gradient.specular[0].size, p.size);
  for (size_t i = 0; i < state.levels.size(); ++i)
    EFFIGY_CHECK_EQ(State::map(gradient, i).size, state.levels[i].size);
  std::vector<std::vector<F4>> slots(static_cast<size_t>(thread_count()));
  parallel_for(kBatches, 1, [&](size_t begin, size_t end, int slot) {
    std::vector<F4>& nodes = slots[static_cast<size_t>(slot)];
    nodes.assign(p.nodes(), splat(0));
    std::vector<float> moved(kLanes * p.nodes());
    for (size_t batch = begin; batch < end; ++batch) {
      if (batch > begin) std::fill(moved.begin(), moved.end(), 0.0f);
      for (size_t i = 0; i < state.levels.size(); ++i) {
        const PrefilterRows& rows = state.levels[i].rows;
        const float* texels = State::map(gradient, i).texels.data();
        for (const OutputLevel::Output& output : state.levels[i].outputs) {
          float value[kLanes];
          for (size_t k = 0; k < kBatch; ++k) {
            const uint32_t texel = output.texel[batch * kBatch + k];
            for (size_t c = 0; c < 3; ++c)
              value[c * kBatch + k] =
                  texel == OutputLevel::kNone ? 0.0f : texels[3 * size_t{texel} + c];
          }
          apply_row_transposed(&rows.group[output.first_group],
                               &rows.weight[4 * size_t{output.first_group}], output.groups, value,
                               moved.data());
        }
      }
      scatter_batch(p, batch, moved.data(), nodes.data());
    }
  });
  std::vector<F4>& nodes = slots[0];
  for (size_t s = 1; s < slots.size(); ++s) {
    if (slots[s].empty()) continue;
    for (size_t i = 0; i < nodes.size(); ++i) nodes[i] += slots[s][i];
  }
  for (int level = p.coarsest; level < p.depth; ++level) {
    for (size_t i = p.offset[level + 1]; i < p.offset[level + 2]; ++i)
      for (const FluxPyramid::Parent& parent : p.parents[i])
        nodes[i] += splat(parent.weight) * nodes[parent.node];
  }
  const size_t base = p.offset[p.depth];
  for (size_t i = 0; i < p.source_texel.size(); ++i) {
    const F4 value = splat(p.solid_angle[base + i]) * nodes[base + i];
    const size_t texel = 3 * size_t{p.source_texel[i]};
    for (size_t c = 0; c < 3; ++c)
      d_radiance.texels[texel + c] +=
          value[static_cast<int>(c)] + gradient.specular[0].texels[texel + c];
  }
}

PrefilteredEnvironment prefilter_environment(const Image& equirectangular, double rotation,
                                             double scale) {
  int size = 16;
  while (size < 128 && 8 * size <= equirectangular.width) size *= 2;
  Cubemap cubemap = cubemap_from_equirectangular(equirectangular, size, rotation);
  for (float& value : cubemap.texels) value *= static_cast<float>(scale);
  return Prefilter(size).forward(cubemap);
}

}  // namespace effigy
