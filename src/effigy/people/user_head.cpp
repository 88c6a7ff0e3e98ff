#include "effigy/people/user_head.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <set>
#include <tuple>

#include "effigy/base/error.h"
#include "effigy/geometry/topology.h"
#include "effigy/people/expression_names.h"
#include "effigy/people/humanoid.h"
#include "effigy/people/user_parts.h"

namespace effigy {
namespace {

using people::UserSource;

constexpr float kFollows = 0.3f;                     // of the weight: here the head is cut off
constexpr float kSliver = 0.05f;                     // of an edge
constexpr float kSmallest = 0.12f, kTallest = 0.7f;  // metres, of the head with its neck
constexpr float kSamePlace = 1e-6f;                  // metres: doubled vertices, but for rounding
constexpr float kStill = 2e-5f;                      // metres: a target that moves less is left out
constexpr double kTurned = 0.1;                      // radians: a head turned less faces ahead
constexpr float kEyeShare = 0.9f;                    // of a triangle's weight

struct Joints {
  int neck = -1, head = -1, jaw = -1, eye_left = -1, eye_right = -1;
  bool body = false;           // arms or legs
  Vec3d left = Vec3d::Zero();  // the person's left, as far as the skeleton tells
};

bool is_above(const UserSource& source, int joint, int other) {
  for (; other >= 0; other = source.joints[static_cast<size_t>(other)].parent)
    if (other == joint) return true;
  return false;
}

Joints find_joints(const UserSource& source) {
  std::vector<std::string> names;
  std::vector<int> parents;
  for (const people::UserJoint& j : source.joints) {
    names.push_back(j.name);
    parents.push_back(j.parent);
  }
  const std::map<std::string, int> person = humanoid_joints(names, parents),
                                   face = face_joints(names);
  const auto find = [](const std::map<std::string, int>& known, const char* name) {
    const auto at = known.find(name);
    return at == known.end() ? -1 : at->second;
  };
  Joints found;
  found.head = find(person, "head");
  found.neck = find(person, "neck");
  if (found.neck < 0 || (found.head >= 0 && !is_above(source, found.neck, found.head)))
    found.neck = found.head;
  found.jaw = find(face, "jaw");
  found.eye_left = find(face, "eye_left");
  found.eye_right = find(face, "eye_right");
  // What lies elsewhere is no part of this head.
  for (int* part : {&found.jaw, &found.eye_left, &found.eye_right})
    if (found.neck >= 0 && !is_above(source, found.neck, *part)) *part = -1;
  const auto place = [&](int j) { return source.joints[static_cast<size_t>(j)].position; };
  if (found.eye_left >= 0 && found.eye_right >= 0)
    found.left = place(found.eye_left) - place(found.eye_right);
  for (const std::string limb : {"upper_arm", "upper_leg", "shoulder"}) {
    const int l = find(person, (limb + "_left").c_str()),
              r = find(person, (limb + "_right").c_str());
    if (l < 0 || r < 0) continue;
    found.body |= limb != "shoulder";
    if (found.left.norm() < 1e-6) found.left = place(l) - place(r);
  }
  return found;
}

// Turns everything about the vertical until the person's left is +x.
void face_forward(const Joints& joints, UserSource& source) {
  const double angle = std::atan2(joints.left.z(), joints.left.x());
  if (std::hypot(joints.left.x(), joints.left.z()) < 1e-4 || std::abs(angle) < kTurned) return;
  const Mat3d turn = Eigen::AngleAxisd(angle, Vec3d::UnitY()).toRotationMatrix();
  const auto turn_all = [&](std::vector<float>& vectors) {
    for (size_t i = 0; i + 2 < vectors.size(); i += 3) {
      Eigen::Map<Vec3f> v(&vectors[i]);
      v = (turn * Vec3f(v).cast<double>()).cast<float>();
    }
  };
  turn_all(source.mesh.vertices);
  for (people::UserShape& shape : source.shapes) turn_all(shape.offsets);
  for (people::UserJoint& joint : source.joints) joint.position = turn * joint.position;
}

// Weights of the new joints: root, neck, jaw, eye_left, eye_right.
constexpr size_t kRoot = 0, kNeck = 1, kJaw = 2, kEyeLeft = 3, kEyeRight = 4, kJoints = 5;
using Weights = std::array<float, kJoints>;

std::vector<Weights> head_weights(const Joints& joints, const UserSource& source) {
  std::vector<size_t> group(source.joints.size(), kRoot);
  for (size_t j = 0; j < group.size(); ++j) {
    for (int at = static_cast<int>(j); at >= 0;
         at = source.joints[static_cast<size_t>(at)].parent) {
      group[j] = at == joints.jaw         ? kJaw
                 : at == joints.eye_left  ? kEyeLeft
                 : at == joints.eye_right ? kEyeRight
                 : at == joints.neck      ? kNeck
                                          : kRoot;
      if (group[j] != kRoot) break;
    }
  }
  std::vector<Weights> out(source.weights.size(), Weights{});
  for (size_t v = 0; v < out.size(); ++v) {
    float sum = 0;
    for (const auto& [joint, weight] : source.weights[v]) sum += weight;
    for (const auto& [joint, weight] : source.weights[v])
      if (sum > 1e-6f) out[v][group[static_cast<size_t>(joint)]] += weight / sum;
    // Without a neck all of it is the head; so is what follows no joint.
    if (joints.neck < 0) {
      out[v][kNeck] += out[v][kRoot];
      out[v][kRoot] = 0;
    }
    if (sum <= 1e-6f) out[v] = Weights{0, 1, 0, 0, 0};
  }
  return out;
}

// Keeps the head, makes one vertex of those that are the same, and leaves out what no triangle
// uses.
class Cutter {
 public:
  Cutter(const UserSource& whole, const std::vector<Weights>& weights, bool cut)
      : whole_(whole), weights_(weights) {
    out_.file = whole.file;
    out_.materials = whole.materials;
    out_.mesh.parts = whole.mesh.parts;
    weld();
    for (size_t f = 0; f < whole.mesh.triangles.size(); ++f) add_triangle(f, cut);
    take_vertices();
  }
  UserSource take() { return std::move(out_); }
  const std::vector<Weights>& weights() const { return kept_weights_; }

 private:
  // Between two vertices of the whole; share 0: the first itself.
  struct Between {
    int from, to;
    float share;
    bool operator<(const Between& o) const {
      return std::tie(from, to, share) < std::tie(o.from, o.to, o.share);
    }
  };
  struct Corner {
    Between place;
    Vec2f uv;
  };

  float follows(int v) const { return 1 - weights_[static_cast<size_t>(v)][kRoot]; }

  bool same(int a, int b) const {
    for (size_t j = 0; j < kJoints; ++j)
      if (std::abs(weights_[static_cast<size_t>(a)][j] - weights_[static_cast<size_t>(b)][j]) >
          1e-3f)
        return false;
    for (const people::UserShape& shape : whole_.shapes)
      for (size_t c = 0; c < 3; ++c)
        if (std::abs(shape.offsets[3 * static_cast<size_t>(a) + c] -
                     shape.offsets[3 * static_cast<size_t>(b) + c]) > 1e-6f)
          return false;
    return true;
  }

  // The first of the vertices that are the same, for each.
  void weld() {
    std::map<std::array<int64_t, 3>, std::vector<int>> at_place;
    for (int v = 0; v < whole_.mesh.vertex_count(); ++v) {
      const Vec3f p = whole_.mesh.vertex(v);
      const auto cell = [](float x) {
        return static_cast<int64_t>(std::llround(static_cast<double>(x / kSamePlace)));
      };
      std::vector<int>& here = at_place[{cell(p.x()), cell(p.y()), cell(p.z())}];
      const auto found =
          std::find_if(here.begin(), here.end(), [&](int other) { return same(v, other); });
      first_.push_back(found == here.end() ? v : *found);
      if (found == here.end()) here.push_back(v);
    }
  }

  // Cut where the share of the head's joints passes kFollows.
  void add_triangle(size_t f, bool cut) {
    const Vec3i &t = whole_.mesh.triangles[f], &u = whole_.mesh.uv_triangles[f];
    const auto uv = [&](int k) { return whole_.mesh.uvs[static_cast<size_t>(u[k])]; };
    std::vector<Corner> corners;
    for (int k = 0; k < 3; ++k) {
      const int next = (k + 1) % 3, a = first_[static_cast<size_t>(t[k])],
                b = first_[static_cast<size_t>(t[next])];
      const bool here = !cut || follows(a) >= kFollows, there = !cut || follows(b) >= kFollows;
      if (here) corners.push_back({{a, a, 0}, uv(k)});
      if (here == there) continue;
      // The same point from both sides of the edge; not so near its ends that slivers arise.
      const int from = std::min(a, b), to = std::max(a, b);
      const float share = std::clamp((kFollows - follows(from)) / (follows(to) - follows(from)),
                                     kSliver, 1 - kSliver);
      const float along = from == a ? share : 1 - share;
      corners.push_back({{from, to, share}, (1 - along) * uv(k) + along * uv(next)});
    }
    for (size_t k = 2; k < corners.size(); ++k) {
      const Corner* fan[3] = {&corners[0], &corners[k - 1], &corners[k]};
      Vec3i kept, kept_uv;
      for (int c = 0; c < 3; ++c) kept[c] = keep(fan[c]->place);
      if (kept[0] == kept[1] || kept[1] == kept[2] || kept[0] == kept[2]) continue;
      for (int c = 0; c < 3; ++c) {
        kept_uv[c] = static_cast<int>(out_.mesh.uvs.size());
        out_.mesh.uvs.push_back(fan[c]->uv);
      }
      out_.mesh.triangles.push_back(kept);
      out_.mesh.uv_triangles.push_back(kept_uv);
      out_.mesh.triangle_part.push_back(whole_.mesh.triangle_part[f]);
    }
  }

  int keep(const Between& place) {
    const auto [found, fresh] = number_.emplace(place, static_cast<int>(kept_.size()));
    if (fresh) kept_.push_back(place);
    return found->second;
  }

  void take_vertices() {
    const auto blend = [](const std::vector<float>& all, const Between& b, size_t c) {
      return (1 - b.share) * all[3 * static_cast<size_t>(b.from) + c] +
             b.share * all[3 * static_cast<size_t>(b.to) + c];
    };
    for (const Between& b : kept_) {
      for (size_t c = 0; c < 3; ++c)
        out_.mesh.vertices.push_back(blend(whole_.mesh.vertices, b, c));
      Weights w;
      for (size_t j = 0; j < kJoints; ++j)
        w[j] = (1 - b.share) * weights_[static_cast<size_t>(b.from)][j] +
               b.share * weights_[static_cast<size_t>(b.to)][j];
      kept_weights_.push_back(w);
    }
    for (const people::UserShape& shape : whole_.shapes) {
      people::UserShape kept{shape.name, {}};
      float most = 0;
      for (const Between& b : kept_)
        for (size_t c = 0; c < 3; ++c) {
          kept.offsets.push_back(blend(shape.offsets, b, c));
          most = std::max(most, std::abs(kept.offsets.back()));
        }
      if (most > kStill) out_.shapes.push_back(std::move(kept));
    }
  }

  const UserSource& whole_;
  const std::vector<Weights>& weights_;
  std::vector<int> first_;
  std::map<Between, int> number_;
  std::vector<Between> kept_;
  std::vector<Weights> kept_weights_;
  UserSource out_;
};

struct Extent {
  Vec3f low = Vec3f::Constant(1e9f), high = Vec3f::Constant(-1e9f);
  float height() const { return high.y() - low.y(); }
};
Extent extent_of(const Mesh& mesh) {
  Extent e;
  for (int v = 0; v < mesh.vertex_count(); ++v) {
    e.low = e.low.cwiseMin(mesh.vertex(v));
    e.high = e.high.cwiseMax(mesh.vertex(v));
  }
  return e;
}

// Where a head turns whose file does not say: in the middle of its lowest part.
Vec3d neck_of(const Mesh& mesh) {
  constexpr float kLowest = 0.15f;
  const Extent e = extent_of(mesh);
  Vec3d sum = Vec3d::Zero();
  double count = 0;
  for (int v = 0; v < mesh.vertex_count(); ++v)
    if (mesh.vertex(v).y() < e.low.y() + kLowest * e.height()) {
      sum += mesh.vertex(v).cast<double>();
      ++count;
    }
  return sum / std::max(count, 1.0);
}

// The new joints, of those that the head has; weights by them.
void set_joints(const Joints& found, const UserSource& whole, const std::vector<Weights>& weights,
                UserSource& head) {
  const auto place = [&](int j) { return whole.joints[static_cast<size_t>(j)].position; };
  const Vec3d neck = found.neck >= 0 ? place(found.neck) : neck_of(head.mesh);
  std::array<int, kJoints> number = {0, 1, -1, -1, -1};
  head.joints = {{"root", -1, neck}, {"neck", 0, neck}};
  const std::array<std::pair<const char*, int>, 3> more = {
      {{"jaw", found.jaw}, {"eye_left", found.eye_left}, {"eye_right", found.eye_right}}};
  for (size_t k = 0; k < more.size(); ++k) {
    const size_t joint = kJaw + k;
    const bool used = std::any_of(weights.begin(), weights.end(),
                                  [&](const Weights& w) { return w[joint] > 0.01f; });
    if (more[k].second < 0 || !used) continue;
    number[joint] = static_cast<int>(head.joints.size());
    head.joints.push_back({more[k].first, 1, place(more[k].second)});
  }
  for (const Weights& w : weights) {
    std::vector<std::pair<int, float>> row;
    for (size_t j = 0; j < kJoints; ++j)
      if (w[j] > 0) row.emplace_back(number[j] < 0 ? 1 : number[j], w[j]);
    head.weights.push_back(std::move(row));
  }
}

// Known names first; names stay unique.
int name_shapes(std::vector<people::UserShape>& shapes) {
  std::set<std::string> taken;
  int known = 0;
  std::vector<char> named(shapes.size(), 0);
  for (size_t k = 0; k < shapes.size(); ++k) {
    const std::string name = known_expression(shapes[k].name);
    if (name.empty() || !taken.insert(name).second) continue;
    shapes[k].name = name;
    named[k] = 1;
    ++known;
  }
  for (size_t k = 0; k < shapes.size(); ++k) {
    if (named[k]) continue;
    std::string name = shapes[k].name;
    for (int n = 2; !taken.insert(name).second; ++n)
      name = shapes[k].name + "_" + std::to_string(n);
    shapes[k].name = name;
  }
  return known;
}

bool names_any(const std::string& name, std::initializer_list<const char*> words) {
  std::string lower;
  for (const char c : name) lower += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return std::any_of(words.begin(), words.end(),
                     [&](const char* word) { return lower.find(word) != std::string::npos; });
}

constexpr const char* kParts[] = {"skin",  "eye_left", "eye_right", "teeth",
                                  "mouth", "hair",     "cloth"};
enum Part { kSkin, kLeftEye, kRightEye, kTeeth, kMouth, kHair, kCloth };

Part part_of(const std::string& material, float x, float middle) {
  if (names_any(material, {"hair", "brow", "lash", "beard", "stubble"})) return kHair;
  if (names_any(material, {"teeth", "tooth"})) return kTeeth;
  if (names_any(material, {"tongue", "gum", "mouth"})) return kMouth;
  if (names_any(material, {"shirt", "cloth", "jacket", "collar", "outfit", "suit", "dress", "hat"}))
    return kCloth;
  if (names_any(material, {"eye", "cornea", "sclera", "iris"}) &&
      !names_any(material, {"lid", "shadow"}))
    return x > middle ? kLeftEye : kRightEye;
  return kSkin;
}

// Parts by the rig's usual names, instead of the materials' own.
void set_parts(Rig& rig) {
  Mesh& mesh = rig.mesh;
  const Extent e = extent_of(mesh);
  const float middle = 0.5f * (e.low.x() + e.high.x());
  const int eyes[2] = {rig.joint("eye_left"), rig.joint("eye_right")};
  std::vector<int> parts;
  for (size_t f = 0; f < mesh.triangles.size(); ++f) {
    const Vec3i& t = mesh.triangles[f];
    const float x = (mesh.vertex(t[0]).x() + mesh.vertex(t[1]).x() + mesh.vertex(t[2]).x()) / 3;
    int part = part_of(mesh.parts[static_cast<size_t>(mesh.triangle_part[f])], x, middle);
    for (int side = 0; side < 2; ++side) {
      if (eyes[side] < 0) continue;
      float share = 0;
      for (int k = 0; k < 3; ++k)
        share += rig.weights[static_cast<size_t>(t[k]) * static_cast<size_t>(rig.joint_count()) +
                             static_cast<size_t>(eyes[side])] /
                 3;
      if (share > kEyeShare) part = kLeftEye + side;
    }
    parts.push_back(part);
  }
  // Something has to be the skin.
  if (std::find(parts.begin(), parts.end(), static_cast<int>(kSkin)) == parts.end())
    std::fill(parts.begin(), parts.end(), static_cast<int>(kSkin));
  mesh.parts.assign(std::begin(kParts), std::end(kParts));
  mesh.triangle_part = std::move(parts);
}

// The longest rim of the skin in the head's lowest part.
void find_neck_ring(Rig& rig) {
  constexpr float kLow = 0.4f;
  const Extent e = extent_of(rig.mesh);
  std::vector<Vec3i> skin;
  for (size_t f = 0; f < rig.mesh.triangles.size(); ++f)
    if (rig.mesh.triangle_part[f] == kSkin) skin.push_back(rig.mesh.triangles[f]);
  for (const std::vector<int>& loop : boundary_loops(skin, rig.mesh.vertex_count())) {
    float height = 0;
    for (const int v : loop) height += rig.mesh.vertex(v).y() / static_cast<float>(loop.size());
    if (height > e.low.y() + kLow * e.height()) continue;
    rig.neck_ring = loop;
    return;
  }
}

}  // namespace

UserHead read_user_head(const Path& path, int texture_size) {
  const bool folder = std::filesystem::is_directory(path);
  UserSource source = folder ? people::read_makehuman(path, {}, people::UserKind::kHead)
                             : people::read_gltf(path, people::UserKind::kHead);
  if (!source.joints.empty()) people::sort_joints(source);
  const Joints joints = find_joints(source);
  UserHead head;
  head.cut = joints.body;
  if (joints.body && joints.neck < 0)
    throw Error(path.string() +
                ": the body has no joint called neck or head, so nobody knows where its head is; "
                "name it so, or give the head alone.");
  face_forward(joints, source);
  const std::vector<Weights> whole = head_weights(joints, source);
  Cutter cutter(source, whole, joints.body);
  const std::vector<Weights> weights = cutter.weights();
  UserSource part = cutter.take();
  if (part.mesh.triangles.empty())
    throw Error(path.string() +
                ": no triangle follows the head's joint; paint its weights and export it again.");
  const float height = extent_of(part.mesh).height();
  if (!(height > kSmallest && height < kTallest))
    throw Error(path.string() + ": the head is " + std::to_string(height) +
                " metres tall; scale it to a person's size (glTF counts in metres, y up).");
  set_joints(joints, source, weights, part);
  head.known_expressions = name_shapes(part.shapes);
  head.look = people::finish_user_body(std::move(part), "user",
                                       folder ? "CC0-1.0" : "the user's own", texture_size);
  set_parts(head.look.rig);
  find_neck_ring(head.look.rig);
  check_rig(head.look.rig, path.string());
  return head;
}

}  // namespace effigy
