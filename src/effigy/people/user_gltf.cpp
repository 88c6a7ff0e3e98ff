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

using people::UserJoint;
using people::UserMaterial;
using people::UserSource;

constexpr size_t kMostNodes = 20'000;
constexpr size_t kMostElements = 20'000'000;

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
  explicit GltfReader(const Path& path) : name_(path.string()) {
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
  }

  UserSource read() {
    place_nodes();
    collect_joints();
    collect_materials();
    for (const int node : order_)
      if (model_.nodes[static_cast<size_t>(node)].mesh >= 0) add_mesh(node);
    if (source_.mesh.triangles.empty()) fail("has no triangle mesh in its scene");
    if (!skinned_) fail("has no skinned mesh; export it with its armature");
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

  // One accessor as floats, `width` per element.
  std::vector<float> numbers(int index, int type, const char* what) const {
    const tinygltf::Accessor& a = item(model_.accessors, index, "accessor");
    const int width = type == TINYGLTF_TYPE_MAT4 ? 16 : type == TINYGLTF_TYPE_SCALAR ? 1 : type;
    if (a.type != type || a.sparse.isSparse)
      fail(std::string("has ") + what +
           " of an unexpected type; export it again without compression");
    const tinygltf::BufferView& view = item(model_.bufferViews, a.bufferView, "buffer view");
    const tinygltf::Buffer& buffer = item(model_.buffers, view.buffer, "buffer");
    const int bytes = tinygltf::GetComponentSizeInBytes(static_cast<uint32_t>(a.componentType));
    const int stride = a.ByteStride(view);
    if (bytes <= 0 || stride < bytes * width || stride > 4096 || a.count > kMostElements)
      fail(std::string("has ") + what + " with an impossible layout");
    const uint64_t begin = static_cast<uint64_t>(view.byteOffset) + a.byteOffset;
    const uint64_t need = a.count == 0 ? 0
                                       : (a.count - 1) * static_cast<uint64_t>(stride) +
                                             static_cast<uint64_t>(bytes * width);
    if (view.byteOffset > buffer.data.size() || a.byteOffset > buffer.data.size() ||
        view.byteLength > buffer.data.size() - view.byteOffset ||
        a.byteOffset + need > view.byteLength || begin + need > buffer.data.size())
      fail(std::string("has ") + what + " that reach beyond their buffer");
    std::vector<float> out;
    out.reserve(a.count * static_cast<size_t>(width));
    for (size_t i = 0; i < a.count; ++i)
      for (int c = 0; c < width; ++c) {
        const uint8_t* p = buffer.data.data() + begin + i * static_cast<size_t>(stride) +
                           static_cast<size_t>(c * bytes);
        out.push_back(component(p, a.componentType, a.normalized, what));
        if (!std::isfinite(out.back())) fail(std::string("has ") + what + " that are not finite");
      }
    return out;
  }
  float component(const uint8_t* p, int type, bool normalized, const char* what) const {
    const auto get = [p](auto value) {
      std::memcpy(&value, p, sizeof(value));
      return static_cast<float>(value);
    };
    switch (type) {
      case TINYGLTF_COMPONENT_TYPE_FLOAT:
        return get(float{});
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

  void collect_materials() {
    for (const tinygltf::Material& m : model_.materials) {
      UserMaterial out;
      out.name = m.name.empty() ? "material_" + std::to_string(source_.materials.size()) : m.name;
      const auto& pbr = m.pbrMetallicRoughness;
      for (size_t c = 0; c < 4 && pbr.baseColorFactor.size() == 4; ++c)
        out.colour[static_cast<int>(c)] =
            std::clamp(static_cast<float>(pbr.baseColorFactor[c]), 0.0f, 1.0f);
      out.roughness = std::clamp(static_cast<float>(pbr.roughnessFactor), 0.05f, 1.0f);
      if (pbr.baseColorTexture.index >= 0) {
        const tinygltf::Texture& t = item(model_.textures, pbr.baseColorTexture.index, "texture");
        item(model_.images, t.source, "image");
        const auto picture = pictures_.find(t.source);
        if (picture == pictures_.end()) fail("has a texture without a picture");
        out.texture = picture->second;
      }
      source_.materials.push_back(std::move(out));
    }
    source_.materials.push_back({"plain", Vec4f(0.5f, 0.5f, 0.5f, 1), 0.6f, {}});
    for (const UserMaterial& m : source_.materials) source_.mesh.parts.push_back(m.name);
  }

  void add_mesh(int node_number) {
    const tinygltf::Node& node = model_.nodes[static_cast<size_t>(node_number)];
    const tinygltf::Mesh& mesh = item(model_.meshes, node.mesh, "mesh");
    for (const tinygltf::Primitive& p : mesh.primitives) {
      if (p.mode != TINYGLTF_MODE_TRIANGLES && p.mode != -1) continue;
      add_primitive(node_number, node, mesh.name, p);
    }
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
      Eigen::Vector4d posed = Eigen::Vector4d::Zero();
      std::vector<std::pair<int, float>> row;
      if (skin != nullptr) {
        double sum = 0;
        for (size_t c = 0; c < 4; ++c) {
          const float w = weights[4 * v + c];
          if (w == 0) continue;
          const size_t j = static_cast<size_t>(joints[4 * v + c]);
          if (joints[4 * v + c] < 0 || j >= skin->joints.size())
            fail("has a weight for a joint that does not exist");
          if (w < 0) fail("has a negative skinning weight");
          posed += static_cast<double>(w) * (matrices[j] * q);
          sum += static_cast<double>(w);
          row.emplace_back(joint_of_node_[static_cast<size_t>(skin->joints[j])], w);
        }
        posed = sum > 1e-6 ? Eigen::Vector4d(posed / sum)
                           : Eigen::Vector4d(world_[static_cast<size_t>(node_number)] * q);
      } else {
        posed = world_[static_cast<size_t>(node_number)] * q;
        const int joint = joint_above(node_number);
        if (joint >= 0) row.emplace_back(joint, 1.0f);
      }
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
  bool skinned_ = false;
};

}  // namespace

UserBody read_gltf_body(const Path& path, int texture_size) {
  return people::finish_user_body(GltfReader(path).read(), "gltf", "the user's own", texture_size);
}

}  // namespace effigy
