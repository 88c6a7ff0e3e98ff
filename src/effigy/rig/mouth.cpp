#include "effigy/rig/mouth.h"

#include <algorithm>
#include <array>

#include "effigy/base/error.h"
#include "effigy/geometry/topology.h"

namespace effigy {
namespace {

// Lengths below are in units of the mouth's width (about 52 mm on FLAME's template).
constexpr int kColumns = 15;   // of a row of teeth
constexpr int kToothRows = 4;  // front root, front edge, back edge, back root
constexpr int kBagRings = 5;   // besides the rim, which is shared with the lips

// The UV band and how the islands share it.
constexpr float kBandLow = 0.957f, kBandHigh = 0.993f;
constexpr float kUpperLeft = 0.150f, kUpperRight = 0.300f;
constexpr float kLowerLeft = 0.315f, kLowerRight = 0.465f;
constexpr float kBagLeft = 0.480f, kBagRight = 0.850f;

// A vertex made from others: position = sum of coefficient * vertex (per axis) + offset. The
// coefficients of each axis sum to 1, so the vertex moves along when all others do.
struct Follower {
  std::vector<std::pair<int, Vec3f>> terms;
  Vec3f offset = Vec3f::Zero();
  float motion = 0;  // how much of the terms' expression and pose shapes it takes over
  float jaw = 0;     // skinning: jaw, the rest neck ...
  int lip = -1;      // ... mixed with the skinning of this vertex
  float lip_share = 0;
};

class MouthBuilder {
 public:
  MouthBuilder(Rig& rig, const std::string& name) : rig_(rig), name_(name) {}

  void build() {
    neck_ = rig_.joint("neck");
    jaw_ = rig_.joint("jaw");
    if (neck_ < 0 || jaw_ < 0) fail("it has no joints 'neck' and 'jaw'");
    if (rig_.mesh.uv_triangles.empty()) fail("it has no UVs");
    check_band();
    find_rim();
    first_ = rig_.mesh.vertex_count();
    add_teeth(true);
    add_teeth(false);
    add_bag();
    append();
  }

 private:
  [[noreturn]] void fail(const std::string& why) const {
    throw Error(name_ + ": teeth and mouth cannot be added to this rig (" + why +
                "); use FLAME's own head and UV layout.");
  }

  void check_band() const {
    constexpr int kSize = 1024;
    const std::vector<uint8_t> covered = uv_coverage(rig_.mesh, kSize);
    const auto texel = [](float t) { return static_cast<size_t>(t * kSize); };
    for (size_t row = texel(1 - kBandHigh); row <= texel(1 - kBandLow); ++row)
      for (size_t column = texel(kUpperLeft); column <= texel(kBagRight); ++column)
        if (covered[row * kSize + column])
          fail("its UV layout uses the band kept for the mouth, v " + std::to_string(kBandLow) +
               " to " + std::to_string(kBandHigh));
  }

  Vec3f point(int vertex) const { return rig_.mesh.vertex(vertex); }

  // The rim of the lips, its centre, width and upper and lower halves.
  void find_rim() {
    std::vector<Vec3i> skin;
    const auto part = std::find(rig_.mesh.parts.begin(), rig_.mesh.parts.end(), "skin");
    if (part == rig_.mesh.parts.end()) fail("it has no part 'skin'");
    const int number = static_cast<int>(part - rig_.mesh.parts.begin());
    for (size_t f = 0; f < rig_.mesh.triangles.size(); ++f)
      if (rig_.mesh.triangle_part[f] == number) skin.push_back(rig_.mesh.triangles[f]);
    auto loops = boundary_loops(skin, rig_.mesh.vertex_count());
    std::erase_if(loops, [&](const std::vector<int>& loop) {
      return std::find(rig_.neck_ring.begin(), rig_.neck_ring.end(), loop.front()) !=
             rig_.neck_ring.end();
    });
    if (loops.size() != 1 || loops[0].size() < 8) fail("its lips are not one open rim");
    rim_ = loops[0];
    Vec3f low = point(rim_[0]), high = low;
    center_.setZero();
    for (const int vertex : rim_) {
      low = low.cwiseMin(point(vertex));
      high = high.cwiseMax(point(vertex));
      center_ += point(vertex) / static_cast<float>(rim_.size());
    }
    width_ = high.x() - low.x();
    half_height_ = 0.5f * (high.y() - low.y());
    middle_y_ = 0.5f * (high.y() + low.y());
    if (!(width_ > 0) || !(half_height_ > 0)) fail("its lips are degenerate");
  }

  // The point of the rim's upper or lower arc at `x`, as a combination of two vertices.
  std::vector<std::pair<int, float>> on_arc(float x, bool upper) const {
    std::vector<std::pair<int, float>> best;
    float best_y = 0;
    for (size_t i = 0; i < rim_.size(); ++i) {
      const int a = rim_[i], b = rim_[(i + 1) % rim_.size()];
      const float xa = point(a).x(), xb = point(b).x();
      if (xa == xb || (x - xa) * (x - xb) > 0) continue;
      const float t = (x - xa) / (xb - xa);
      const float y = (1 - t) * point(a).y() + t * point(b).y();
      if (best.empty() || (upper ? y > best_y : y < best_y)) {
        best = {{a, 1 - t}, {b, t}};
        best_y = y;
      }
    }
    if (best.empty()) fail("its lips are not one closed rim");
    return best;
  }

  // Adds `scale` (per axis) times (combination - centre) and the centre itself.
  void follow(Follower& follower, const std::vector<std::pair<int, float>>& combination,
              const Vec3f& scale) const {
    for (const auto& [vertex, share] : combination)
      follower.terms.emplace_back(vertex, share * scale);
    for (const int vertex : rim_)
      follower.terms.emplace_back(vertex,
                                  (Vec3f::Ones() - scale) / static_cast<float>(rim_.size()));
  }

  void add_uv(float u, float v) { rig_.mesh.uvs.emplace_back(u, v); }
  void add_triangle(const Vec3i& vertices, const Vec3i& uvs, int part_number) {
    rig_.mesh.triangles.push_back(vertices);
    rig_.mesh.uv_triangles.push_back(uvs);
    rig_.mesh.triangle_part.push_back(part_number);
  }
  // A cell of a grid with corners a b (above) and c d (below), seen from outside.
  void add_cell(const std::array<int, 4>& v, const std::array<int, 4>& uv, int part_number) {
    add_triangle(Vec3i(v[1], v[0], v[2]), Vec3i(uv[1], uv[0], uv[2]), part_number);
    add_triangle(Vec3i(v[1], v[2], v[3]), Vec3i(uv[1], uv[2], uv[3]), part_number);
  }
  int part(const std::string& part_name) {
    auto& parts = rig_.mesh.parts;
    const auto found = std::find(parts.begin(), parts.end(), part_name);
    if (found != parts.end()) return static_cast<int>(found - parts.begin());
    parts.push_back(part_name);
    return static_cast<int>(parts.size()) - 1;
  }

  // A strip of rows x columns; row 0 is the root in front, columns run from -x to +x.
  void add_teeth(bool upper) {
    const float w = width_, sign = upper ? 1.0f : -1.0f;
    // Upper teeth overlap the lower ones a little and stand in front of them.
    const float height[kToothRows] = {0.17f * w, upper ? -0.02f * w : 0.0f,
                                      upper ? -0.02f * w : 0.0f, 0.17f * w};
    const float behind = upper ? 0.045f * w : 0.105f * w;
    const float depth[kToothRows] = {0, 0, 0.05f * w, 0.12f * w};
    const int first_vertex = first_ + static_cast<int>(followers_.size());
    const int first_uv = static_cast<int>(rig_.mesh.uvs.size());
    const float plane = middle_y_ + 0.02f * w;
    for (int row = 0; row < kToothRows; ++row)
      for (int column = 0; column < kColumns; ++column) {
        const float f = -0.9f + 1.8f * static_cast<float>(column) / (kColumns - 1);
        Follower tooth;
        auto combination = on_arc(center_.x() + 0.5f * f * w, true);
        for (const auto& term : on_arc(center_.x() + 0.5f * f * w, false))
          combination.push_back(term);
        for (auto& term : combination) term.second *= 0.5f;
        // x and z follow the lips' arch, y only the mouth as a whole.
        const float narrow = row < 2 ? 0.93f : 0.86f;
        follow(tooth, combination, Vec3f(narrow, 0, 1));
        tooth.offset = Vec3f(0, plane + sign * height[row] - center_.y(),
                             -behind - depth[row] - 0.25f * w * f * f);
        tooth.jaw = upper ? 0.0f : 1.0f;
        followers_.push_back(std::move(tooth));
        const float left = upper ? kUpperLeft : kLowerLeft;
        const float right = upper ? kUpperRight : kLowerRight;
        const float down = static_cast<float>(row) / (kToothRows - 1);
        add_uv(left + (right - left) * static_cast<float>(column) / (kColumns - 1),
               upper ? kBandHigh - (kBandHigh - kBandLow) * down
                     : kBandLow + (kBandHigh - kBandLow) * down);
      }
    add_grid(first_vertex, first_uv, kToothRows, kColumns, upper, part("teeth"));
  }

  // Triangles of a grid of vertices and UVs that share one numbering; `down` when rows go down in
  // the front view.
  void add_grid(int first_vertex, int first_uv, int rows, int columns, bool down, int part_number) {
    for (int row = 0; row + 1 < rows; ++row)
      for (int column = 0; column + 1 < columns; ++column) {
        const int a = row * columns + column;
        std::array<int, 4> corner = {a, a + 1, a + columns, a + columns + 1};
        if (!down) corner = {a + columns, a + columns + 1, a, a + 1};
        std::array<int, 4> v, uv;
        for (size_t i = 0; i < 4; ++i) {
          v[i] = first_vertex + corner[i];
          uv[i] = first_uv + corner[i];
        }
        add_cell(v, uv, part_number);
      }
  }

  // Rings of the bag: depth behind the rim, scale across and up, scale of the rim's own curve.
  struct Ring {
    float depth, across, up, curve;
  };
  static constexpr Ring kRings[kBagRings] = {{0.08f, 1.05f, 1.5f, 1.0f},
                                             {0.30f, 1.0f, 1.6f, 0.9f},
                                             {0.55f, 0.9f, 1.4f, 0.7f},
                                             {0.80f, 0.7f, 1.0f, 0.4f},
                                             {0.98f, 0.4f, 0.5f, 0.1f}};
  static constexpr float kApexDepth = 1.05f;

  // Share of the jaw in the lower half; fades with depth.
  float jaw_share(int vertex, float depth) const {
    const float up = std::clamp((point(vertex).y() - middle_y_) / half_height_, -1.0f, 1.0f);
    return (0.5f - 0.5f * up) * (1 - 0.6f * depth);
  }

  void add_bag() {
    const int part_number = part("mouth");
    const size_t n = rim_.size();
    const int first_vertex = first_ + static_cast<int>(followers_.size());
    for (const Ring& ring : kRings)
      for (const int vertex : rim_) {
        Follower follower;
        follow(follower, {{vertex, 1.0f}}, Vec3f(ring.across, ring.up, ring.curve));
        follower.offset = Vec3f(0, 0, -ring.depth * width_);
        follower.motion = std::max(0.0f, 1 - 3 * ring.depth);
        follower.lip = vertex;
        follower.lip_share = follower.motion;
        follower.jaw = jaw_share(vertex, ring.depth);
        followers_.push_back(std::move(follower));
      }
    Follower apex;
    follow(apex, {}, Vec3f::Zero());
    apex.offset = Vec3f(0, 0, -kApexDepth * width_);
    apex.jaw = 0.5f * (1 - 0.6f * kApexDepth);
    followers_.push_back(std::move(apex));

    // The rim unrolled: n + 1 columns, the rim at the top, and an own UV for the apex in each
    // column.
    const int first_uv = static_cast<int>(rig_.mesh.uvs.size());
    const int columns = static_cast<int>(n) + 1;
    const auto u = [&](float column) {
      return kBagLeft + (kBagRight - kBagLeft) * column / static_cast<float>(n);
    };
    const float row_height = (kBandHigh - kBandLow) / (kBagRings + 1);
    for (int row = 0; row <= kBagRings; ++row)
      for (int column = 0; column < columns; ++column)
        add_uv(u(static_cast<float>(column)), kBandHigh - row_height * static_cast<float>(row));
    for (size_t column = 0; column < n; ++column)
      add_uv(u(static_cast<float>(column) + 0.5f), kBandLow);
    const auto vertex_at = [&](int row, int column) {
      const size_t i = static_cast<size_t>(column) % n;
      return row == 0 ? rim_[i] : first_vertex + (row - 1) * (columns - 1) + static_cast<int>(i);
    };
    const auto uv_at = [&](int row, int column) { return first_uv + row * columns + column; };
    const int apex_vertex = first_ + static_cast<int>(followers_.size()) - 1;
    // The skin has the edge rim[i] -> rim[i + 1], so the bag has it the other way round.
    for (int i = 0; i + 1 < columns; ++i) {
      for (int row = 0; row < kBagRings; ++row)
        add_cell({vertex_at(row, i), vertex_at(row, i + 1), vertex_at(row + 1, i),
                  vertex_at(row + 1, i + 1)},
                 {uv_at(row, i), uv_at(row, i + 1), uv_at(row + 1, i), uv_at(row + 1, i + 1)},
                 part_number);
      add_triangle(Vec3i(vertex_at(kBagRings, i + 1), vertex_at(kBagRings, i), apex_vertex),
                   Vec3i(uv_at(kBagRings, i + 1), uv_at(kBagRings, i), uv_at(kBagRings + 1, 0) + i),
                   part_number);
    }
  }

  // One value per axis of a combination of the rows of `values` (3 per vertex).
  static Vec3f combine(const Follower& follower, const float* values) {
    Vec3f sum = Vec3f::Zero();
    for (const auto& [vertex, share] : follower.terms)
      sum += share.cwiseProduct(Eigen::Map<const Vec3f>(values + 3 * static_cast<size_t>(vertex)));
    return sum;
  }

  // Lengthens every row of a basis by the new vertices.
  void extend_basis(std::vector<float>& basis, bool moving) const {
    const size_t old3 = 3 * static_cast<size_t>(first_);
    const size_t new3 = old3 + 3 * followers_.size();
    std::vector<float> longer;
    longer.reserve(basis.size() / old3 * new3);
    for (size_t begin = 0; begin < basis.size(); begin += old3) {
      const float* row = basis.data() + begin;
      longer.insert(longer.end(), row, row + old3);
      for (const Follower& follower : followers_) {
        const float share = moving ? follower.motion : 1.0f;
        const Vec3f value =
            share == 0 ? Vec3f(Vec3f::Zero()) : Vec3f(share * combine(follower, row));
        longer.insert(longer.end(), value.data(), value.data() + 3);
      }
    }
    basis = std::move(longer);
  }

  void append() {
    extend_basis(rig_.identity_basis, false);
    extend_basis(rig_.expression_basis, true);
    extend_basis(rig_.pose_basis, true);
    std::vector<float> added;
    for (const Follower& follower : followers_) {
      const Vec3f position = combine(follower, rig_.mesh.vertices.data()) + follower.offset;
      added.insert(added.end(), position.data(), position.data() + 3);
    }
    rig_.mesh.vertices.insert(rig_.mesh.vertices.end(), added.begin(), added.end());

    const size_t joints = rig_.parents.size(), old_count = static_cast<size_t>(first_);
    std::vector<float> regressor(joints * (old_count + followers_.size()), 0.0f);
    for (size_t j = 0; j < joints; ++j)
      std::copy_n(rig_.joint_regressor.data() + j * old_count, old_count,
                  regressor.data() + j * (old_count + followers_.size()));
    rig_.joint_regressor = std::move(regressor);
    for (const Follower& follower : followers_)
      for (size_t j = 0; j < joints; ++j) {
        const int joint = static_cast<int>(j);
        float weight = joint == jaw_ ? follower.jaw : joint == neck_ ? 1 - follower.jaw : 0.0f;
        if (follower.lip >= 0)
          weight += follower.lip_share *
                    (rig_.weights[static_cast<size_t>(follower.lip) * joints + j] - weight);
        rig_.weights.push_back(weight);
      }
  }

  Rig& rig_;
  const std::string& name_;
  int neck_ = -1, jaw_ = -1;
  std::vector<int> rim_;
  Vec3f center_ = Vec3f::Zero();
  float width_ = 0, half_height_ = 0, middle_y_ = 0;
  int first_ = 0;  // number of the first new vertex
  std::vector<Follower> followers_;
};

}  // namespace

void add_mouth(Rig& rig, const std::string& name) {
  MouthBuilder(rig, name).build();
}

}  // namespace effigy
