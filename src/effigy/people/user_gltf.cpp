// glTF 2.0 files. tinygltf parses; everything it hands on is checked here before use.

#include <tiny_gltf.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>

#include "effigy/base/error.h"
#include "effigy/image/files.h"
#include "effigy/people/user_parts.h"

namespace effigy {
namespace {

using people::UserKind;
using people::UserMaterial;
using people::UserSource;

constexpr size_t kMostNodes = 20'000;
constexpr size_t kMostElements = 20'000'000;
constexpr size_t kMostShapes = 1000;

// Pictures are decoded by our own reader.
bool load_picture(tinygltf::Image* image, const int index, std::string* error, std::string*, int,
                  int, const unsigned char* bytes, int size, void* pictures) {
  try {
    auto& list = *static_cast<std::map<int, Image8>*>(pictures);
    list[index] = decode_image8({bytes, static_cast<size_t>(std::max(size, 0))},
                                "texture " + std::to_string(index));
    image->width = list[index].width;
    image->height = list[index].height;
    return true;
  } catch (const std::exception& e) {
    *error += e.what();
    return false;
  }
}

class GltfReader {
 public:
  GltfReader(const Path& path, UserKind kind)
      : name_(path.string()), head_(kind == UserKind::kHead) {
    const std::vector<uint8_t> bytes = read_file(path, uint64_t{1} << 30);
    tinygltf::TinyGLTF loader;
    loader.SetImageLoader(load_picture, &pictures_);
    std::string error, warning;
    const std::string folder = path.parent_path().string();
    const bool binary = bytes.size() >= 4 && std::memcmp(bytes.data(), "glTF", 4) == 0;
    bool good = false;
    try {
      const auto size = static_cast<unsigned int>(bytes.size());
      good = binary ? loader.LoadBinaryFromMemory(&model_, &error, &warning, bytes.data(), size,
                                                  folder)
                    : loader.LoadASCIIFromString(&model_, &error, &warning,
                                                 reinterpret_cast<const char*>(bytes.data()), size,
                                                 folder);
    } catch (const std::exception& e) {
      error = e.what();
    }
    if (!good) {
      std::replace(error.begin(), error.end(), '\n', ' ');
      fail("is not a sound glTF file (" + error.substr(0, 200) + "); export it again");
    }
    for (const std::string& extension : model_.extensionsRequired)
      if (extension != "KHR_mesh_quantization" && extension != "KHR_materials_unlit")
        fail("needs the glTF extension " + extension + "; export it again without");
  }

  UserSource read() {
    place_nodes();
    collect_joints();
    collect_materials();
    for (const int node : order_)
      if (model_.nodes[static_cast<size_t>(node)].mesh >= 0) add_mesh(node);
    if (source_.mesh.triangles.empty()) fail("has no triangle mesh in its scene");
    if (!skinned_ && !head_) fail("has no skinned mesh; export it with its armature");
    for (people::UserShape& shape : source_.shapes)
      shape.offsets.resize(source_.mesh.vertices.size());
    source_.file = name_;
    return std::move(source_);
  }

 private:
  [[noreturn]] void fail(const std::string& what) const {
    throw Error(name_ + ": the file " + what + ".");
  }

  template <typename List>
  const auto& item(const List& list, int index, const char* what) const {
    if (index < 0 || static_cast<size_t>(index) >= list.size())
      fail(std::string("names ") + what + " " + std::to_string(index) +
           ", which does not exist; export it again");
    return list[static_cast<size_t>(index)];
  }

  // `count` elements of `width` numbers in a buffer view, as floats.
  std::vector<float> stored(int view_number, size_t offset, int component_type, bool normalized,
                            size_t count, int width, int stride, const char* what) const {
    const tinygltf::BufferView& view = item(model_.bufferViews, view_number, "buffer view");
    const tinygltf::Buffer& buffer = item(model_.buffers, view.buffer, "buffer");
    const int bytes = tinygltf::GetComponentSizeInBytes(static_cast<uint32_t>(component_type));
    if (bytes <= 0 || stride < bytes * width || stride > 4096 || count > kMostElements)
      fail(std::string("has ") + what + " with an impossible layout");
    const uint64_t begin = static_cast<uint64_t>(view.byteOffset) + offset;
    const uint64_t need = count == 0 ? 0
                                     : (count - 1) * static_cast<uint64_t>(stride) +
                                           static_cast<uint64_t>(bytes * width);
    if (view.byteOffset > buffer.data.size() || offset > buffer.data.size() ||
        view.byteLength > buffer.data.size() - view.byteOffset || offset + need > view.byteLength ||
        begin + need > buffer.data.size())
      fail(std::string("has ") + what + " that reach beyond their buffer");
    std::vector<float> out;
    out.reserve(count * static_cast<size_t>(width));
    for (size_t i = 0; i < count; ++i)
      for (int c = 0; c < width; ++c) {
        const uint8_t* p = buffer.data.data() + begin + i * static_cast<size_t>(stride) +
                           static_cast<size_t>(c * bytes);
        out.push_back(component(p, component_type, normalized, what));
        if (!std::isfinite(out.back())) fail(std::string("has ") + what + " that are not finite");
      }
    return out;
  }

  // One accessor as floats.
  std::vector<float> numbers(int index, int type, const char* what) const {
    const tinygltf::Accessor& a = item(model_.accessors, index, "accessor");
    const int width = type == TINYGLTF_TYPE_MAT4 ? 16 : type == TINYGLTF_TYPE_SCALAR ? 1 : type;
    if (a.type != type)
      fail(std::string("has ") + what +
           " of an unexpected type; export it again without compression");
    std::vector<float> out;
    if (a.bufferView >= 0 || !a.sparse.isSparse) {
      const tinygltf::BufferView& view = item(model_.bufferViews, a.bufferView, "buffer view");
      out = stored(a.bufferView, a.byteOffset, a.componentType, a.normalized, a.count, width,
                   a.ByteStride(view), what);
    } else if (a.count > kMostElements) {
      fail(std::string("has ") + what + " with an impossible layout");
    } else {
      out.assign(a.count * static_cast<size_t>(width), 0.0f);
    }
    if (a.sparse.isSparse) replace_sparse(a, width, what, out);
    return out;
  }
  // Sparse accessors say which elements differ.
  void replace_sparse(const tinygltf::Accessor& a, int width, const char* what,
                      std::vector<float>& out) const {
    const auto& sparse = a.sparse;
    if (sparse.count < 0) fail(std::string("has ") + what + " with an impossible layout");
    const auto count = static_cast<size_t>(sparse.count);
    const auto size_of = [](int component_type) {
      return tinygltf::GetComponentSizeInBytes(static_cast<uint32_t>(component_type));
    };
    const std::vector<float> places = stored(
        sparse.indices.bufferView, static_cast<size_t>(std::max(sparse.indices.byteOffset, 0)),
        sparse.indices.componentType, false, count, 1, size_of(sparse.indices.componentType), what);
    const std::vector<float> values =
        stored(sparse.values.bufferView, static_cast<size_t>(std::max(sparse.values.byteOffset, 0)),
               a.componentType, a.normalized, count, width, width * size_of(a.componentType), what);
    for (size_t i = 0; i < count; ++i) {
      const auto place = static_cast<size_t>(places[i]);
      if (!(places[i] >= 0) || place >= a.count)
        fail(std::string("has ") + what + " at a place that does not exist");
      std::copy_n(values.begin() + static_cast<std::ptrdiff_t>(i * static_cast<size_t>(width)),
                  width,
                  out.begin() + static_cast<std::ptrdiff_t>(place * static_cast<size_t>(width)));
    }
  }
  float component(const uint8_t* p, int type, bool normalized, const char* what) const {
    const auto get = [p](auto value) {
      std::memcpy(&value, p, sizeof(value));
      return static_cast<float>(value);
    };
    switch (type) {
      case TINYGLTF_COMPONENT_TYPE_FLOAT:
        return get(float{});
      case TINYGLTF_COMPONENT_TYPE_BYTE:
        return normalized ? std::max(get(int8_t{}) / 127.0f, -1.0f) : get(int8_t{});
      case TINYGLTF_COMPONENT_TYPE_SHORT:
        return normalized ? std::max(get(int16_t{}) / 32767.0f, -1.0f) : get(int16_t{});
      case TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE:
        return get(uint8_t{}) / (normalized ? 255.0f : 1.0f);
      case TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT:
        return get(uint16_t{}) / (normalized ? 65535.0f : 1.0f);
      case TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT: {
        const float value = get(uint32_t{});
        if (value >= 16777216.0f) fail(std::string("has ") + what + " above 16777215");
        return value;
      }
      default:
        fail(std::string("has ") + what + " of an unknown number type");
    }
  }

  static Mat4d local_matrix(const tinygltf::Node& node) {
    Mat4d m = Mat4d::Identity();
    if (node.matrix.size() == 16) {
      for (int i = 0; i < 16; ++i) m(i % 4, i / 4) = node.matrix[static_cast<size_t>(i)];
      return m;
    }
    const auto get = [](const std::vector<double>& v, size_t n, size_t i, double standard) {
      return v.size() == n ? v[i] : standard;
    };
    const Eigen::Quaterniond q(get(node.rotation, 4, 3, 1), get(node.rotation, 4, 0, 0),
                               get(node.rotation, 4, 1, 0), get(node.rotation, 4, 2, 0));
    const Mat3d r = q.norm() > 1e-9 ? q.normalized().toRotationMatrix() : Mat3d(Mat3d::Identity());
    for (int c = 0; c < 3; ++c) {
      m.block<3, 1>(0, c) = r.col(c) * get(node.scale, 3, static_cast<size_t>(c), 1);
      m(c, 3) = get(node.translation, 3, static_cast<size_t>(c), 0);
    }
    return m;
  }

  void place_nodes() {
    if (model_.nodes.size() > kMostNodes) fail("has more than 20000 nodes");
    world_.assign(model_.nodes.size(), Mat4d::Identity());
    parent_.assign(model_.nodes.size(), -1);
    std::vector<char> seen(model_.nodes.size(), 0);
    if (model_.scenes.empty()) fail("has no scene");
    const tinygltf::Scene& scene = item(model_.scenes, std::max(model_.defaultScene, 0), "scene");
    order_ = scene.nodes;
    for (const int n : order_) {
      item(model_.nodes, n, "node");
      if (seen[static_cast<size_t>(n)]++) fail("uses a node twice");
    }
    for (size_t i = 0; i < order_.size(); ++i) {
      const size_t n = static_cast<size_t>(order_[i]);
      const Mat4d local = local_matrix(model_.nodes[n]);
      if (!local.allFinite()) fail("has a node whose place is not finite");
      world_[n] = parent_[n] < 0 ? local : Mat4d(world_[static_cast<size_t>(parent_[n])] * local);
      for (const int child : model_.nodes[n].children) {
        item(model_.nodes, child, "node");
        if (seen[static_cast<size_t>(child)]++) fail("uses a node twice");
        parent_[static_cast<size_t>(child)] = order_[i];
        order_.push_back(child);
      }
    }
  }

  void collect_joints() {
    joint_of_node_.assign(model_.nodes.size(), -1);
    for (const tinygltf::Skin& skin : model_.skins)
      for (const int n : skin.joints) {
        const tinygltf::Node& node = item(model_.nodes, n, "node");
        int& number = joint_of_node_[static_cast<size_t>(n)];
        if (number >= 0) continue;
        number = static_cast<int>(source_.joints.size());
        source_.joints.push_back({node.name.empty() ? "joint_" + std::to_string(n) : node.name, -1,
                                  world_[static_cast<size_t>(n)].block<3, 1>(0, 3)});
      }
    for (size_t n = 0; n < joint_of_node_.size(); ++n)
      if (joint_of_node_[n] >= 0)
        source_.joints[static_cast<size_t>(joint_of_node_[n])].parent = joint_above(parent_[n]);
  }
  int joint_above(int node) const {
    for (; node >= 0; node = parent_[static_cast<size_t>(node)])
      if (joint_of_node_[static_cast<size_t>(node)] >= 0)
        return joint_of_node_[static_cast<size_t>(node)];
    return -1;
  }

  Image8 picture(int texture) const {
    if (texture < 0) return {};
    const tinygltf::Texture& t = item(model_.textures, texture, "texture");
    item(model_.images, t.source, "image");
    const auto found = pictures_.find(t.source);
    if (found == pictures_.end()) fail("has a texture without a picture");
    return found->second;
  }

  void collect_materials() {
    for (const tinygltf::Material& m : model_.materials) {
      UserMaterial out;
      out.name = m.name.empty() ? "material_" + std::to_string(source_.materials.size()) : m.name;
      const auto& pbr = m.pbrMetallicRoughness;
      for (size_t c = 0; c < 4 && pbr.baseColorFactor.size() == 4; ++c)
        out.colour[static_cast<int>(c)] =
            std::clamp(static_cast<float>(pbr.baseColorFactor[c]), 0.0f, 1.0f);
      out.roughness = std::clamp(static_cast<float>(pbr.roughnessFactor), 0.05f, 1.0f);
      out.opaque = m.alphaMode == "OPAQUE" || m.alphaMode.empty();
      out.texture = picture(pbr.baseColorTexture.index);
      out.roughness_texture = picture(pbr.metallicRoughnessTexture.index);
      out.normal_texture = picture(m.normalTexture.index);
      out.normal_scale = std::clamp(static_cast<float>(m.normalTexture.scale), -8.0f, 8.0f);
      source_.materials.push_back(std::move(out));
    }
    source_.materials.emplace_back();
    source_.materials.back().name = "plain";
    source_.materials.back().colour = Vec4f(0.5f, 0.5f, 0.5f, 1);
    for (const UserMaterial& m : source_.materials) source_.mesh.parts.push_back(m.name);
  }

  void add_mesh(int node_number) {
    const tinygltf::Node& node = model_.nodes[static_cast<size_t>(node_number)];
    const tinygltf::Mesh& mesh = item(model_.meshes, node.mesh, "mesh");
    for (const tinygltf::Primitive& p : mesh.primitives) {
      if (p.mode != TINYGLTF_MODE_TRIANGLES && p.mode != -1) continue;
      turns_.clear();
      add_primitive(node_number, node, mesh.name, p);
      if (head_) add_shapes(mesh, p);
    }
  }

  // The morph targets of the primitive that was added last; targets of one name are one shape.
  void add_shapes(const tinygltf::Mesh& mesh, const tinygltf::Primitive& p) {
    const size_t first = source_.mesh.vertices.size() / 3 - turns_.size();
    for (size_t k = 0; k < p.targets.size(); ++k) {
      const auto found = p.targets[k].find("POSITION");
      if (found == p.targets[k].end()) continue;
      const std::vector<float> offsets =
          numbers(found->second, TINYGLTF_TYPE_VEC3, "morph targets");
      if (offsets.size() != 3 * turns_.size())
        fail("has a morph target with more or fewer offsets than positions");
      std::vector<float>& all = shape(target_name(mesh, k)).offsets;
      all.resize(source_.mesh.vertices.size());
      for (size_t v = 0; v < turns_.size(); ++v) {
        const Vec3d moved = turns_[v] * Vec3f(&offsets[3 * v]).cast<double>();
        for (int c = 0; c < 3; ++c)
          all[3 * (first + v) + static_cast<size_t>(c)] += static_cast<float>(moved[c]);
      }
    }
  }
  people::UserShape& shape(const std::string& name) {
    for (people::UserShape& known : source_.shapes)
      if (known.name == name) return known;
    if (source_.shapes.size() >= kMostShapes) fail("has more than 1000 morph targets");
    source_.shapes.push_back({name, {}});
    return source_.shapes.back();
  }
  // Exporters keep the names in the mesh's extras.
  static std::string target_name(const tinygltf::Mesh& mesh, size_t k) {
    if (mesh.extras.IsObject() && mesh.extras.Has("targetNames")) {
      const tinygltf::Value& names = mesh.extras.Get("targetNames");
      if (names.IsArray() && k < names.ArrayLen() && names.Get(static_cast<int>(k)).IsString())
        return names.Get(static_cast<int>(k)).Get<std::string>();
    }
    return "target_" + std::to_string(k);
  }

  // Skinning matrices at the rest pose, and the joints' numbers.
  void skin_matrices(const tinygltf::Skin& skin, std::vector<Mat4d>& matrices) const {
    std::vector<float> inverse;
    if (skin.inverseBindMatrices >= 0) {
      inverse = numbers(skin.inverseBindMatrices, TINYGLTF_TYPE_MAT4, "inverse bind matrices");
      if (inverse.size() < 16 * skin.joints.size())
        fail("has fewer inverse bind matrices than joints");
    }
    for (size_t j = 0; j < skin.joints.size(); ++j) {
      Mat4d bind = Mat4d::Identity();
      if (!inverse.empty())
        for (int i = 0; i < 16; ++i)
          bind(i % 4, i / 4) = static_cast<double>(inverse[16 * j + static_cast<size_t>(i)]);
      matrices.push_back(world_[static_cast<size_t>(skin.joints[j])] * bind);
    }
  }

  void add_primitive(int node_number, const tinygltf::Node& node, const std::string& mesh_name,
                     const tinygltf::Primitive& p) {
    const auto attribute = [&](const char* name) {
      const auto found = p.attributes.find(name);
      return found == p.attributes.end() ? -1 : found->second;
    };
    if (attribute("POSITION") < 0) fail("has a mesh without positions");
    if (attribute("TEXCOORD_0") < 0)
      fail("has no UVs on mesh '" + mesh_name + "'; unwrap it and export it again");
    const std::vector<float> positions =
        numbers(attribute("POSITION"), TINYGLTF_TYPE_VEC3, "positions");
    const std::vector<float> uvs = numbers(attribute("TEXCOORD_0"), TINYGLTF_TYPE_VEC2, "UVs");
    const size_t count = positions.size() / 3;
    if (uvs.size() != 2 * count) fail("has a mesh with more or fewer UVs than positions");
    std::vector<float> joints, weights;
    std::vector<Mat4d> matrices;
    const tinygltf::Skin* skin = nullptr;
    if (node.skin >= 0) {
      skin = &item(model_.skins, node.skin, "skin");
      if (attribute("JOINTS_0") < 0 || attribute("WEIGHTS_0") < 0)
        fail("has a skin but no weights on mesh '" + mesh_name + "'");
      joints = numbers(attribute("JOINTS_0"), TINYGLTF_TYPE_VEC4, "joints");
      weights = numbers(attribute("WEIGHTS_0"), TINYGLTF_TYPE_VEC4, "weights");
      if (joints.size() != 4 * count || weights.size() != 4 * count)
        fail("has a mesh with more or fewer weights than positions");
      skin_matrices(*skin, matrices);
      skinned_ = true;
    }
    const int first = source_.mesh.vertex_count();
    for (size_t v = 0; v < count; ++v) {
      const Eigen::Vector4d q(positions[3 * v], positions[3 * v + 1], positions[3 * v + 2], 1);
      Mat4d place = world_[static_cast<size_t>(node_number)];
      std::vector<std::pair<int, float>> row;
      if (skin != nullptr) {
        double sum = 0;
        Mat4d blend = Mat4d::Zero();
        for (size_t c = 0; c < 4; ++c) {
          const float w = weights[4 * v + c];
          if (w == 0) continue;
          const size_t j = static_cast<size_t>(joints[4 * v + c]);
          if (joints[4 * v + c] < 0 || j >= skin->joints.size())
            fail("has a weight for a joint that does not exist");
          if (w < 0) fail("has a negative skinning weight");
          blend += static_cast<double>(w) * matrices[j];
          sum += static_cast<double>(w);
          row.emplace_back(joint_of_node_[static_cast<size_t>(skin->joints[j])], w);
        }
        if (sum > 1e-6) place = blend / sum;
      } else {
        const int joint = joint_above(node_number);
        if (joint >= 0) row.emplace_back(joint, 1.0f);
      }
      const Eigen::Vector4d posed = place * q;
      turns_.push_back(place.topLeftCorner<3, 3>());
      for (int c = 0; c < 3; ++c) source_.mesh.vertices.push_back(static_cast<float>(posed[c]));
      // glTF counts v from the top.
      source_.mesh.uvs.emplace_back(uvs[2 * v], 1 - uvs[2 * v + 1]);
      source_.weights.push_back(std::move(row));
    }
    const int part = p.material >= 0 ? p.material : static_cast<int>(source_.materials.size()) - 1;
    item(source_.materials, part, "material");
    std::vector<float> indices;
    if (p.indices >= 0)
      indices = numbers(p.indices, TINYGLTF_TYPE_SCALAR, "indices");
    else
      for (size_t v = 0; v < count; ++v) indices.push_back(static_cast<float>(v));
    if (indices.size() % 3 != 0) fail("has a number of indices that is no multiple of three");
    for (size_t i = 0; i + 2 < indices.size(); i += 3) {
      Vec3i t;
      for (int k = 0; k < 3; ++k) {
        const float index = indices[i + static_cast<size_t>(k)];
        if (!(index >= 0 && index < static_cast<float>(count)))
          fail("has an index beyond its vertices");
        t[k] = first + static_cast<int>(index);
      }
      if (t[0] == t[1] || t[1] == t[2] || t[0] == t[2]) continue;
      source_.mesh.triangles.push_back(t);
      source_.mesh.uv_triangles.push_back(t);
      source_.mesh.triangle_part.push_back(part);
    }
  }

  std::string name_;
  std::map<int, Image8> pictures_;
  tinygltf::Model model_;
  UserSource source_;
  std::vector<Mat4d> world_;
  std::vector<int> parent_, order_, joint_of_node_;
  std::vector<Mat3d> turns_;  // of each vertex of the last primitive: from its space to the world
  bool head_, skinned_ = false;
};

}  // namespace

people::UserSource people::read_gltf(const Path& path, UserKind kind) {
  return GltfReader(path, kind).read();
}

UserBody read_gltf_body(const Path& path, int texture_size) {
  return people::finish_user_body(people::read_gltf(path, people::UserKind::kBody), "gltf",
                                  "the user's own", texture_size);
}

}  // namespace effigy
