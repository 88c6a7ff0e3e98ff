#include "effigy/rig/flame.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cstdlib>
#include <map>

#include "effigy/base/error.h"
#include "effigy/base/json.h"
#include "effigy/base/npy.h"
#include "effigy/base/pickle.h"
#include "effigy/geometry/topology.h"
#include "effigy/rig/mouth.h"

namespace effigy {
namespace {

constexpr int kVertices = 5023, kTriangles = 9976, kJoints = 5;
constexpr int kIdentities = 300, kExpressions = 100, kPoseFeatures = 9 * (kJoints - 1);
constexpr const char* kWanted =
    "give generic_model.pkl of FLAME 2020, flame2023.pkl or flame2023_Open.pkl from "
    "flame.is.tue.mpg.de";

[[noreturn]] void wrong_model(const Path& path, const std::string& why) {
  throw Error(path.string() + ": not a FLAME head model this program knows (" + why + "); " +
              kWanted + ".");
}

// The numeric array of a key; -1 in `shape` matches any length.
const NpyArray& array_of(const PickleValue& model, const char* key,
                         const std::vector<int64_t>& shape, const Path& path) {
  const PickleValue* value = model.find(key);
  if (value == nullptr || value->kind != PickleValue::Kind::kArray)
    wrong_model(path, std::string("its array '") + key + "' is missing");
  if (value->array.shape != shape) {
    std::string found;
    for (const int64_t length : value->array.shape)
      found += (found.empty() ? "" : " x ") + std::to_string(length);
    wrong_model(path, std::string("its array '") + key + "' is " + found);
  }
  return value->array;
}

// Names the models that people mistake for FLAME.
void check_vertex_count(const PickleValue& model, const Path& path) {
  const PickleValue* value = model.find("v_template");
  if (value == nullptr || value->kind != PickleValue::Kind::kArray)
    wrong_model(path, "it has no array 'v_template'");
  const int64_t count = value->array.shape.empty() ? 0 : value->array.shape[0];
  if (count == kVertices) return;
  static const std::map<int64_t, const char*> kOthers = {{6890, ", an SMPL body"},
                                                         {10475, ", an SMPL-X body"},
                                                         {778, ", a MANO hand"},
                                                         {3889, ", a SMAL animal"}};
  const auto other = kOthers.find(count);
  wrong_model(path, std::to_string(count) + " vertices instead of 5023" +
                        (other == kOthers.end() ? "" : other->second));
}

std::string lower_case(std::string text) {
  for (char& c : text) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return text;
}

// The version, by the file's name, the folder's name, or the way the file was written.
std::string version_of(const Path& path, const Pickle& pickle) {
  const bool chumpy = pickle.globals().count("chumpy.ch.Ch") != 0;
  const Path absolute = std::filesystem::absolute(path);
  for (const std::string& raw :
       {absolute.filename().string(), absolute.parent_path().filename().string()}) {
    const std::string name = lower_case(raw);
    const auto says = [&](const char* word) { return name.find(word) != std::string::npos; };
    if (says("no_jaw") || says("nojaw"))
      wrong_model(path, "this is the variant without jaw rotation");
    if (says("2019")) wrong_model(path, "FLAME 2019 has other coefficients than 2020");
    if (says("2023") && says("open")) {
      // 2023 Open is the only one under a free licence, so the claim is checked.
      if (chumpy)
        wrong_model(path, "it is named 2023 Open, but was written like FLAME 2020; rename it");
      return "flame-2023-open";
    }
    if (says("2023")) return "flame-2023";
    if (says("2020") || says("generic_model") || says("male_model")) return "flame-2020";
  }
  return chumpy ? "flame-2020" : "flame-2023";
}

// Beside the .pkl, in the given folder, in the data folder; empty when it is nowhere.
Path find_asset(const Path& pkl, const FlameAssets& assets,
                std::initializer_list<const char*> names) {
  std::vector<Path> folders = {pkl.parent_path().empty() ? Path(".") : pkl.parent_path()};
  if (!assets.folder.empty()) folders.push_back(assets.folder);
  if (const char* data = std::getenv("EFFIGY_DATA"))
    folders.push_back(Path(data) / "face/flame_topology");
  for (const Path& folder : folders)
    for (const char* name : names) {
      std::error_code ignored;
      if (std::filesystem::is_regular_file(folder / name, ignored)) return folder / name;
    }
  return {};
}

// [V][3][K] (columns first .. first + count) to [count][V][3].
std::vector<float> directions(const NpyArray& array, int first, int count) {
  const std::vector<float> all = array.floats();
  const size_t width = static_cast<size_t>(array.shape[2]), rows = all.size() / width;
  std::vector<float> result(static_cast<size_t>(count) * rows);
  for (size_t k = 0; k < static_cast<size_t>(count); ++k)
    for (size_t i = 0; i < rows; ++i)
      result[k * rows + i] = all[i * width + k + static_cast<size_t>(first)];
  return result;
}

void read_joints(const PickleValue& model, const Path& path, Rig& rig) {
  const std::vector<int64_t> tree = array_of(model, "kintree_table", {2, kJoints}, path).integers();
  const std::array<int64_t, kJoints> expected = {-1, 0, 1, 1, 1};
  for (size_t j = 0; j < kJoints; ++j) {
    // The root's parent is 2^32 - 1 in unsigned tables.
    const int64_t parent = j == 0 && tree[0] == 4294967295 ? -1 : tree[j];
    if (parent != expected[j]) wrong_model(path, "its joints are not FLAME's");
    rig.parents.push_back(static_cast<int>(parent));
  }
  const PickleValue* regressor = model.find("J_regressor");
  if (regressor != nullptr && regressor->kind == PickleValue::Kind::kSparse) {
    if (regressor->sparse.rows != kJoints || regressor->sparse.columns != kVertices)
      wrong_model(path, "its matrix 'J_regressor' is not 5 x 5023");
    const std::vector<double> dense = regressor->sparse.dense();
    rig.joint_regressor.assign(dense.begin(), dense.end());
  } else {
    rig.joint_regressor = array_of(model, "J_regressor", {kJoints, kVertices}, path).floats();
  }
  rig.weights = array_of(model, "weights", {kVertices, kJoints}, path).floats();
  for (size_t v = 0; v < kVertices; ++v) {
    // The published rows sum to 1 up to rounding; anything further off is left to check_rig.
    float* row = rig.weights.data() + v * kJoints;
    float sum = 0;
    for (size_t j = 0; j < kJoints; ++j) sum += row[j];
    if (sum > 0.99f && sum < 1.01f)
      for (size_t j = 0; j < kJoints; ++j) row[j] /= sum;
  }
  double jaw = 0;
  for (size_t v = 0; v < kVertices; ++v) jaw += static_cast<double>(rig.weights[v * kJoints + 2]);
  if (!(jaw > 1))
    wrong_model(path, "its jaw joint moves nothing: the variant without jaw rotation");
  const RigShape shape = shape_rig(rig, {});
  const bool third_is_left = shape.joints[9] > shape.joints[12];
  rig.joint_names = {"root", "neck", "jaw", third_is_left ? "eye_left" : "eye_right",
                     third_is_left ? "eye_right" : "eye_left"};
}

// Numbers of the corners in ascending order: the same for the same triangle.
std::array<int, 3> key_of(const Vec3i& t) {
  std::array<int, 3> key = {t[0], t[1], t[2]};
  std::sort(key.begin(), key.end());
  return key;
}

// The UVs of an OBJ with the same triangles, in whatever order it lists them.
void read_uvs(const Path& path, const Path& pkl, Mesh& mesh) {
  const Mesh layout = read_obj(path);
  const std::string remedy =
      "; FLAME's own head_template.obj (5023 vertices, 9976 triangles) is needed.";
  if (layout.vertex_count() != kVertices || layout.uv_triangles.empty())
    throw Error(path.string() + ": the UV layout does not belong to FLAME (" +
                std::to_string(layout.vertex_count()) + " vertices, " +
                std::to_string(layout.uvs.size()) + " UVs)" + remedy);
  std::map<std::array<int, 3>, size_t> number;
  for (size_t f = 0; f < layout.triangles.size(); ++f) number[key_of(layout.triangles[f])] = f;
  mesh.uvs = layout.uvs;
  for (const Vec3i& t : mesh.triangles) {
    const auto found = number.find(key_of(t));
    if (found == number.end())
      throw Error(path.string() + ": the UV layout lacks triangles of " + pkl.string() + remedy);
    Vec3i uv = Vec3i::Zero();
    for (int corner = 0; corner < 3; ++corner)
      for (int other = 0; other < 3; ++other)
        if (layout.triangles[found->second][other] == t[corner])
          uv[corner] = layout.uv_triangles[found->second][other];
    mesh.uv_triangles.push_back(uv);
  }
}

// The head is the largest connected piece, the eyeballs are the other two.
void find_parts(const Path& path, Rig& rig) {
  Mesh& mesh = rig.mesh;
  const std::vector<int> piece = connected_pieces(mesh.triangles, kVertices);
  std::vector<int> size(static_cast<size_t>(*std::max_element(piece.begin(), piece.end())) + 1);
  std::vector<double> x(size.size());
  for (size_t v = 0; v < piece.size(); ++v) {
    const auto p = static_cast<size_t>(piece[v]);
    ++size[p];
    x[p] += static_cast<double>(mesh.vertices[3 * v]);
  }
  if (size.size() != 3) wrong_model(path, "it is not made of a head and two eyeballs");
  const auto head = static_cast<size_t>(std::max_element(size.begin(), size.end()) - size.begin());
  const size_t one = head == 0 ? 1 : 0, other = head == 2 ? 1 : 2;
  const size_t left = x[one] > x[other] ? one : other;
  mesh.parts = {"skin", "eye_left", "eye_right"};
  std::vector<Vec3i> skin;
  for (const Vec3i& t : mesh.triangles) {
    const auto p = static_cast<size_t>(piece[static_cast<size_t>(t[0])]);
    mesh.triangle_part.push_back(p == head ? 0 : p == left ? 1 : 2);
    if (p == head) skin.push_back(t);
  }
  // The neck's rim is the lowest boundary.
  const auto height = [&](const std::vector<int>& loop) {
    double sum = 0;
    for (const int v : loop)
      sum += static_cast<double>(mesh.vertices[3 * static_cast<size_t>(v) + 1]);
    return sum / static_cast<double>(loop.size());
  };
  const auto loops = boundary_loops(skin, kVertices);
  const auto lowest =
      std::min_element(loops.begin(), loops.end(),
                       [&](const auto& a, const auto& b) { return height(a) < height(b); });
  if (lowest != loops.end()) rig.neck_ring = *lowest;
}

// Eyelid shapes, named by the side on which they move something.
void read_eyelids(const Path& first, const Path& second, Rig& rig) {
  if (first.empty() || second.empty()) return;
  std::array<std::vector<float>, 2> shape;
  std::array<double, 2> side{};
  for (size_t i = 0; i < 2; ++i) {
    const Path& path = i == 0 ? first : second;
    const NpyArray array = read_npy(path);
    if (array.shape != std::vector<int64_t>{kVertices, 3})
      throw Error(path.string() + ": an eyelid shape has 5023 x 3 numbers; download it again.");
    shape[i] = array.floats();
    for (size_t v = 0; v < kVertices; ++v)
      side[i] +=
          static_cast<double>(rig.mesh.vertices[3 * v] *
                              Eigen::Map<const Vec3f>(shape[i].data() + 3 * v).cwiseAbs().sum());
  }
  if (!(side[0] * side[1] < 0))
    throw Error(first.string() + " and " + second.string() +
                ": the two eyelid shapes move the same side; download them again.");
  for (const bool left : {true, false}) {
    const auto& basis = shape[(side[0] > 0) == left ? 0 : 1];
    rig.expression_basis.insert(rig.expression_basis.end(), basis.begin(), basis.end());
    rig.expression_names.push_back(left ? "eyelid_left" : "eyelid_right");
    rig.expression_low.push_back(0);
    rig.expression_high.push_back(1);
    ++rig.expression_count;
  }
}

void read_mediapipe(const Path& path, Rig& rig) {
  const auto arrays = read_npz(path);
  const auto get = [&](const char* name) -> const NpyArray& {
    const auto found = arrays.find(name);
    if (found == arrays.end())
      throw Error(path.string() + ": array '" + name + "' is missing; download it again.");
    return found->second;
  };
  const std::vector<int64_t> points = get("landmark_indices").integers();
  const std::vector<int64_t> faces = get("lmk_face_idx").integers();
  const std::vector<float> weights = get("lmk_b_coords").floats();
  if (faces.size() != points.size() || weights.size() != 3 * points.size())
    throw Error(path.string() + ": its three arrays are not equally long; download it again.");
  for (size_t i = 0; i < points.size(); ++i) {
    if (points[i] < 0 || points[i] >= 478 || faces[i] < 0 || faces[i] >= kTriangles)
      throw Error(path.string() + ": landmark " + std::to_string(i) +
                  " is not on FLAME's mesh; download it again.");
    rig.mediapipe.index.push_back(static_cast<int>(points[i]));
    rig.mediapipe.triangle.push_back(static_cast<int>(faces[i]));
    rig.mediapipe.barycentric.emplace_back(weights[3 * i], weights[3 * i + 1], weights[3 * i + 2]);
  }
}

// The first 68 of the "full" points (two more are eye centres).
void read_multipie(const Path& path, Rig& rig) {
  const Json json = read_json(path);
  const auto faces = json_field<std::vector<int>>(
      json_field<Json>(json, "full_lmk_faces_idx", path), "data", path);
  const auto weights = json_field<std::vector<float>>(
      json_field<Json>(json, "full_lmk_bary_coords", path), "data", path);
  if (faces.size() < 68 || weights.size() != 3 * faces.size())
    throw Error(path.string() + ": fewer than 68 landmarks; download it again.");
  for (size_t i = 0; i < 68; ++i) {
    if (faces[i] < 0 || faces[i] >= kTriangles)
      throw Error(path.string() + ": landmark " + std::to_string(i) +
                  " is not on FLAME's mesh; download it again.");
    rig.multipie.index.push_back(static_cast<int>(i));
    rig.multipie.triangle.push_back(faces[i]);
    rig.multipie.barycentric.emplace_back(weights[3 * i], weights[3 * i + 1], weights[3 * i + 2]);
  }
}

void read_model(const PickleValue& model, const Path& path, Rig& rig) {
  rig.mesh.vertices = array_of(model, "v_template", {kVertices, 3}, path).floats();
  const std::vector<int64_t> faces = array_of(model, "f", {kTriangles, 3}, path).integers();
  for (size_t f = 0; f < faces.size(); f += 3) {
    for (size_t corner = 0; corner < 3; ++corner)
      if (faces[f + corner] < 0 || faces[f + corner] >= kVertices)
        wrong_model(path, "its triangles name vertices that do not exist");
    rig.mesh.triangles.emplace_back(static_cast<int>(faces[f]), static_cast<int>(faces[f + 1]),
                                    static_cast<int>(faces[f + 2]));
  }
  const NpyArray& shapes =
      array_of(model, "shapedirs", {kVertices, 3, kIdentities + kExpressions}, path);
  rig.identity_count = kIdentities;
  rig.expression_count = kExpressions;
  rig.identity_basis = directions(shapes, 0, kIdentities);
  rig.expression_basis = directions(shapes, kIdentities, kExpressions);
  rig.pose_basis = directions(array_of(model, "posedirs", {kVertices, 3, kPoseFeatures}, path), 0,
                              kPoseFeatures);
  // FLAME's coefficients are in standard deviations.
  rig.identity_sigma.assign(kIdentities, 1.0f);
  rig.expression_low.assign(kExpressions, -3.0f);
  rig.expression_high.assign(kExpressions, 3.0f);
  for (int k = 1; k <= kExpressions; ++k) {
    const std::string digits = std::to_string(k);
    rig.expression_names.push_back("expression_" + std::string(3 - digits.size(), '0') + digits);
  }
  read_joints(model, path, rig);
}

}  // namespace

Rig load_flame(const Path& pkl, const FlameAssets& assets) {
  Rig rig;
  {
    const Pickle pickle = read_pickle(pkl);
    if (pickle.root().kind != PickleValue::Kind::kDict) wrong_model(pkl, "it holds no dictionary");
    check_vertex_count(pickle.root(), pkl);
    rig.kind = version_of(pkl, pickle);
    read_model(pickle.root(), pkl, rig);
  }
  rig.licence = rig.kind == "flame-2023-open"
                    ? "model CC-BY-4.0 (MPI), UV layout, eyelids and landmarks MPI non-commercial"
                    : "MPI non-commercial";
  const Path layout = find_asset(pkl, assets, {"head_template.obj", "head_template_mesh.obj"});
  if (layout.empty())
    throw Error(pkl.string() +
                ": FLAME's UV layout head_template.obj was not found beside it; put it there (it "
                "comes with FLAME's texture space) or set EFFIGY_DATA.");
  read_uvs(layout, pkl, rig.mesh);
  find_parts(pkl, rig);
  read_eyelids(find_asset(pkl, assets, {"l_eyelid.npy"}), find_asset(pkl, assets, {"r_eyelid.npy"}),
               rig);
  if (const Path path = find_asset(pkl, assets, {"mediapipe_landmark_embedding.npz"});
      !path.empty())
    read_mediapipe(path, rig);
  if (const Path path = find_asset(pkl, assets, {"landmark_embedding_with_eyes.json"});
      !path.empty())
    read_multipie(path, rig);
  check_rig(rig, pkl.string());
  add_mouth(rig, pkl.string());
  check_rig(rig, pkl.string());
  return rig;
}

}  // namespace effigy
