#include "effigy/rig/rig_file.h"

#include <algorithm>
#include <cctype>
#include <limits>

#include "effigy/base/error.h"
#include "effigy/base/json.h"
#include "effigy/base/safetensors.h"
#include "effigy/rig/flame.h"
#include "effigy/rig/ict.h"

namespace effigy {
namespace {

constexpr const char* kFormat = "effigy-rig-1";

// Vectors of Eigen vectors as flat arrays and back.
template <typename Scalar, typename Vector>
std::vector<Scalar> flatten(const std::vector<Vector>& vectors) {
  std::vector<Scalar> flat;
  flat.reserve(vectors.size() * static_cast<size_t>(Vector::SizeAtCompileTime));
  for (const Vector& vector : vectors)
    for (int i = 0; i < Vector::SizeAtCompileTime; ++i) flat.push_back(vector[i]);
  return flat;
}
template <typename Vector, typename Scalar>
std::vector<Vector> group(const std::vector<Scalar>& flat) {
  constexpr size_t kLength = static_cast<size_t>(Vector::SizeAtCompileTime);
  std::vector<Vector> vectors(flat.size() / kLength);
  for (size_t i = 0; i < vectors.size(); ++i)
    vectors[i] = Eigen::Map<const Vector>(flat.data() + i * kLength);
  return vectors;
}

int64_t length(size_t size) {
  return static_cast<int64_t>(size);
}

void put_landmarks(TensorFile& file, const std::string& name, const LandmarkEmbedding& embedding) {
  if (embedding.size() == 0) return;
  const int64_t n = length(embedding.size());
  file.tensors[name + ".index"] = Tensor::from(std::span<const int32_t>(embedding.index), {n});
  file.tensors[name + ".triangle"] =
      Tensor::from(std::span<const int32_t>(embedding.triangle), {n});
  const std::vector<float> flat = flatten<float>(embedding.barycentric);
  file.tensors[name + ".barycentric"] = Tensor::from(std::span<const float>(flat), {n, 3});
}

LandmarkEmbedding get_landmarks(const TensorFile& file, const std::string& name) {
  LandmarkEmbedding embedding;
  if (!file.has(name + ".index")) return embedding;
  embedding.index = file.ints(name + ".index", {-1});
  const int64_t n = length(embedding.index.size());
  embedding.triangle = file.ints(name + ".triangle", {n});
  embedding.barycentric = group<Vec3f>(file.floats(name + ".barycentric", {n, 3}));
  return embedding;
}

std::string get_text(const TensorFile& file, const std::string& key) {
  const auto found = file.metadata.find(key);
  if (found == file.metadata.end())
    throw Error(file.path.string() + ": metadata field '" + key +
                "' is missing, so this is not a rig of this program; write the file again.");
  return found->second;
}

std::vector<std::string> get_names(const TensorFile& file, const std::string& key) {
  try {
    return Json::parse(get_text(file, key)).get<std::vector<std::string>>();
  } catch (const nlohmann::json::exception&) {
    throw Error(file.path.string() + ": metadata field '" + key +
                "' is not a list of names; write the file again.");
  }
}

std::vector<float> get_basis(const TensorFile& file, const std::string& name, int64_t vertices) {
  return file.has(name) ? file.floats(name, {-1, vertices, 3}) : std::vector<float>();
}

Mesh get_mesh(const TensorFile& file) {
  Mesh mesh;
  mesh.vertices = file.floats("vertices", {-1, 3});
  mesh.triangles = group<Vec3i>(file.ints("triangles", {-1, 3}));
  const int64_t faces = length(mesh.triangles.size());
  if (file.has("uvs")) {
    mesh.uvs = group<Vec2f>(file.floats("uvs", {-1, 2}));
    mesh.uv_triangles = group<Vec3i>(file.ints("uv_triangles", {faces, 3}));
  }
  if (file.has("triangle_part")) mesh.triangle_part = file.ints("triangle_part", {faces});
  mesh.parts = get_names(file, "parts");
  return mesh;
}

TensorFile rig_tensors(const Rig& rig) {
  TensorFile file;
  const int64_t vertices = rig.mesh.vertex_count(), faces = rig.mesh.triangle_count();
  const int64_t joints = rig.joint_count();
  // Empty arrays are left out.
  const auto put = [&](const char* name, const std::vector<float>& values,
                       std::vector<int64_t> shape) {
    if (!values.empty())
      file.tensors[name] = Tensor::from(std::span<const float>(values), std::move(shape));
  };
  const auto put_ints = [&](const char* name, const std::vector<int>& values,
                            std::vector<int64_t> shape) {
    if (!values.empty())
      file.tensors[name] = Tensor::from(std::span<const int32_t>(values), std::move(shape));
  };
  file.metadata["format"] = kFormat;
  file.metadata["kind"] = rig.kind;
  file.metadata["licence"] = rig.licence;
  file.metadata["parts"] = Json(rig.mesh.parts).dump();
  file.metadata["expression_names"] = Json(rig.expression_names).dump();
  file.metadata["joint_names"] = Json(rig.joint_names).dump();
  put("vertices", rig.mesh.vertices, {vertices, 3});
  put_ints("triangles", flatten<int>(rig.mesh.triangles), {faces, 3});
  put("uvs", flatten<float>(rig.mesh.uvs), {length(rig.mesh.uvs.size()), 2});
  put_ints("uv_triangles", flatten<int>(rig.mesh.uv_triangles), {faces, 3});
  put_ints("triangle_part", rig.mesh.triangle_part, {faces});
  put("identity_basis", rig.identity_basis, {rig.identity_count, vertices, 3});
  put("expression_basis", rig.expression_basis, {rig.expression_count, vertices, 3});
  put("pose_basis", rig.pose_basis, {9 * (joints - 1), vertices, 3});
  put("identity_sigma", rig.identity_sigma, {rig.identity_count});
  put("expression_low", rig.expression_low, {rig.expression_count});
  put("expression_high", rig.expression_high, {rig.expression_count});
  put_ints("parents", rig.parents, {joints});
  put("joint_regressor", rig.joint_regressor, {joints, vertices});
  put("weights", rig.weights, {vertices, joints});
  put_landmarks(file, "mediapipe", rig.mediapipe);
  put_landmarks(file, "multipie", rig.multipie);
  put_ints("neck_ring", rig.neck_ring, {length(rig.neck_ring.size())});
  return file;
}

}  // namespace

Rig read_rig(const Path& path) {
  const TensorFile file = read_safetensors(path);
  if (const auto found = file.metadata.find("format");
      found == file.metadata.end() || found->second != kFormat)
    throw Error(path.string() +
                ": not a rig file of this program (metadata field 'format' is not '" +
                std::string(kFormat) + "'); choose another file.");
  Rig rig;
  rig.kind = get_text(file, "kind");
  rig.licence = get_text(file, "licence");
  rig.mesh = get_mesh(file);
  const int64_t vertices = rig.mesh.vertex_count();
  rig.expression_names = get_names(file, "expression_names");
  rig.joint_names = get_names(file, "joint_names");
  rig.parents = file.ints("parents", {-1});
  const int64_t joints = length(rig.parents.size());
  rig.identity_basis = get_basis(file, "identity_basis", vertices);
  rig.expression_basis = get_basis(file, "expression_basis", vertices);
  rig.pose_basis = get_basis(file, "pose_basis", vertices);
  if (file.has("identity_sigma")) rig.identity_sigma = file.floats("identity_sigma", {-1});
  if (file.has("expression_low")) {
    rig.expression_low = file.floats("expression_low", {-1});
    rig.expression_high = file.floats("expression_high", {-1});
  }
  // check_rig compares these with the sizes of the bases.
  rig.identity_count = static_cast<int>(
      std::min<size_t>(rig.identity_sigma.size(), std::numeric_limits<int>::max()));
  rig.expression_count = static_cast<int>(
      std::min<size_t>(rig.expression_names.size(), std::numeric_limits<int>::max()));
  rig.joint_regressor = file.floats("joint_regressor", {joints, vertices});
  rig.weights = file.floats("weights", {vertices, joints});
  rig.mediapipe = get_landmarks(file, "mediapipe");
  rig.multipie = get_landmarks(file, "multipie");
  if (file.has("neck_ring")) rig.neck_ring = file.ints("neck_ring", {-1});
  check_rig(rig, path.string());
  return rig;
}

void write_rig(const Path& path, const Rig& rig) {
  check_rig(rig, path.string());
  write_safetensors(path, rig_tensors(rig));
}

int64_t rig_file_bytes(const Rig& rig) {
  size_t bytes = 0;
  for (const auto& [name, tensor] : rig_tensors(rig).tensors) bytes += tensor.bytes.size();
  return length(bytes);
}

Rig load_rig(const Path& path, const Path& models) {
  constexpr const char* kKnown =
      "give a rig.safetensors file, FLAME's .pkl or ICT-FaceKit's folder.";
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  if (!std::filesystem::exists(path)) throw Error(path.string() + ": no such rig; " + kKnown);
  if (std::filesystem::is_directory(path)) {
    if (is_ict_folder(path)) return load_ict(path, models);
    if (std::filesystem::exists(path / "rig.safetensors"))
      return read_rig(path / "rig.safetensors");
    throw Error(path.string() + ": a folder without a rig this program knows; " + kKnown);
  }
  if (extension == ".safetensors") return read_rig(path);
  if (extension == ".pkl") return load_flame(path, {models});
  throw Error(path.string() + ": not a rig this program knows; " + kKnown);
}

}  // namespace effigy
