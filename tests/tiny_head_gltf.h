// A small glTF file of a person: a ball for a head on a ball for a trunk, with skeleton, morph
// targets and pictures.
#pragma once

#include <cmath>
#include <map>
#include <numbers>
#include <set>
#include <string>
#include <vector>

#include "effigy/base/json.h"
#include "effigy/geometry/types.h"
#include "effigy/image/files.h"
#include "tiny_gltf.h"

namespace effigy::test {

struct TinyHeadOptions {
  bool body = true, skin = true;  // a trunk with arms below; a skeleton
  double scale = 1, turn = 0;     // of everything; radians about the vertical
  bool face_joints = true;        // jaw and eyes
  std::vector<std::string> targets = {"blendShape1.JawOpen", "mouthSmileLeft", "Bulge"};
  bool sparse = false;  // morph targets as sparse accessors
  bool pictures = true;
};

class TinyHeadGltf {
 public:
  explicit TinyHeadGltf(const TinyHeadOptions& options) : o_(options) {}

  // Writes FOLDER/NAME and its pictures.
  void write(const Path& folder, const std::string& name) {
    Json primitives = Json::array();
    primitives.push_back(ball({0, 1.6, 0.02}, 0.11, kHead, 0));
    if (o_.body) primitives.push_back(ball({0, 1.2, 0}, 0.25, kChest, 1));
    Json file = {{"asset", {{"version", "2.0"}}},
                 {"scene", 0},
                 {"materials",
                  {{{"name", "face"}, {"pbrMetallicRoughness", {{"roughnessFactor", 0.8}}}},
                   {{"name", "shirt"},
                    {"pbrMetallicRoughness", {{"baseColorFactor", {0.1, 0.2, 0.7, 1}}}}}}}};
    Json mesh = {{"name", "person"}, {"primitives", primitives}};
    mesh["extras"] = {{"targetNames", o_.targets}};
    file["meshes"] = {mesh};
    if (o_.pictures) add_pictures(folder, file);
    add_nodes(file);
    file["accessors"] = accessors_;
    file["bufferViews"] = views_;
    file["buffers"] = {{{"byteLength", bytes_.size()},
                        {"uri", "data:application/octet-stream;base64," + base64(bytes_)}}};
    write_json(folder / name, file);
  }

 private:
  enum Joint { kHips, kChest, kNeck, kHead, kJaw, kEyeL, kEyeR, kArmL, kArmR, kCount };

  Vec3f placed(const Vec3d& p) const {
    return (Eigen::AngleAxisd(o_.turn, Vec3d::UnitY()) * (o_.scale * p)).cast<float>();
  }

  int view(const std::string& bytes) {
    while (bytes_.size() % 4 != 0) bytes_ += '\0';
    views_.push_back({{"buffer", 0}, {"byteOffset", bytes_.size()}, {"byteLength", bytes.size()}});
    bytes_ += bytes;
    return static_cast<int>(views_.size()) - 1;
  }
  template <typename T>
  static std::string raw(const std::vector<T>& values) {
    return {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)};
  }
  int accessor(const std::string& bytes, int component, size_t count, const char* type) {
    accessors_.push_back({{"bufferView", view(bytes)},
                          {"componentType", component},
                          {"count", count},
                          {"type", type}});
    return static_cast<int>(accessors_.size()) - 1;
  }
  int target(const std::vector<float>& offsets) {
    const size_t count = offsets.size() / 3;
    if (!o_.sparse) return accessor(raw(offsets), 5126, count, "VEC3");
    std::vector<uint16_t> places;
    std::vector<float> values;
    for (size_t v = 0; v < count; ++v) {
      if (Vec3f(&offsets[3 * v]).norm() == 0) continue;
      places.push_back(static_cast<uint16_t>(v));
      values.insert(values.end(), &offsets[3 * v], &offsets[3 * v] + 3);
    }
    const int at = view(raw(places)), what = view(raw(values));
    accessors_.push_back({{"componentType", 5126},
                          {"count", count},
                          {"type", "VEC3"},
                          {"sparse",
                           {{"count", places.size()},
                            {"indices", {{"bufferView", at}, {"componentType", 5123}}},
                            {"values", {{"bufferView", what}}}}}});
    return static_cast<int>(accessors_.size()) - 1;
  }

  // A UV sphere with a seam, as exporters write it: vertices are doubled where UVs part.
  Json ball(const Vec3d& centre, double radius, int joint, int material) {
    constexpr int kRings = 12, kSegments = 20;
    std::vector<float> positions, uvs, weights;
    std::vector<uint8_t> joints;
    std::vector<uint16_t> indices;
    std::vector<std::vector<float>> offsets(o_.targets.size());
    for (int r = 0; r <= kRings; ++r)
      for (int s = 0; s <= kSegments; ++s) {
        const double theta = std::numbers::pi * r / kRings,
                     phi = s == kSegments ? 0 : 2 * std::numbers::pi * s / kSegments;
        const Vec3d out(std::sin(theta) * std::sin(phi), std::cos(theta),
                        std::sin(theta) * std::cos(phi));
        const Vec3f p = placed(centre + radius * out);
        positions.insert(positions.end(), {p.x(), p.y(), p.z()});
        uvs.insert(uvs.end(), {0.02f + 0.96f * static_cast<float>(s) / kSegments,
                               0.02f + 0.96f * static_cast<float>(r) / kRings});
        const bool chin = joint == kHead && o_.face_joints && out.y() < -0.4 && out.z() > 0.3;
        for (const int j : {chin ? static_cast<int>(kJaw) : joint, 0, 0, 0})
          joints.push_back(static_cast<uint8_t>(j));
        weights.insert(weights.end(), {1, 0, 0, 0});
        // Down below, outwards on the person's left, and all around.
        const Vec3d moves[3] = {out.y() < 0 && joint == kHead ? Vec3d(0, -0.02, 0) : Vec3d::Zero(),
                                out.x() > 0.2 && joint == kHead ? Vec3d(0.01, 0, 0) : Vec3d::Zero(),
                                joint == kHead ? Vec3d::Zero() : Vec3d(0.03 * out)};
        for (size_t k = 0; k < offsets.size(); ++k) {
          const Vec3f d = placed(moves[k % 3]);
          offsets[k].insert(offsets[k].end(), {d.x(), d.y(), d.z()});
        }
      }
    const auto at = [](int r, int s) { return static_cast<uint16_t>(r * (kSegments + 1) + s); };
    for (int r = 0; r < kRings; ++r)
      for (int s = 0; s < kSegments; ++s) {
        if (r > 0) indices.insert(indices.end(), {at(r, s), at(r + 1, s), at(r, s + 1)});
        if (r + 1 < kRings)
          indices.insert(indices.end(), {at(r, s + 1), at(r + 1, s), at(r + 1, s + 1)});
      }
    const size_t count = positions.size() / 3;
    Json p = {{"attributes",
               {{"POSITION", accessor(raw(positions), 5126, count, "VEC3")},
                {"TEXCOORD_0", accessor(raw(uvs), 5126, count, "VEC2")}}},
              {"indices", accessor(raw(indices), 5123, indices.size(), "SCALAR")},
              {"material", material}};
    if (o_.skin) {
      p["attributes"]["JOINTS_0"] = accessor(raw(joints), 5121, count, "VEC4");
      p["attributes"]["WEIGHTS_0"] = accessor(raw(weights), 5126, count, "VEC4");
    }
    for (const std::vector<float>& offset : offsets)
      p["targets"].push_back({{"POSITION", target(offset)}});
    return p;
  }

  // Upper half of the face red, lower half green; rougher on the left of the picture; a bump map
  // that leans to +u.
  void add_pictures(const Path& folder, Json& file) {
    Image8 colour(32, 32, 3, 20), rough(32, 32, 3, 128), normal(32, 32, 3, 128);
    for (int y = 0; y < 32; ++y)
      for (int x = 0; x < 32; ++x) {
        colour.at(x, y)[y < 16 ? 0 : 1] = 200;
        rough.at(x, y)[1] = 255;
        normal.at(x, y)[0] = 180;
        normal.at(x, y)[2] = 243;
      }
    write_png8(folder / "colour.png", colour);
    write_png8(folder / "rough.png", rough);
    write_png8(folder / "normal.png", normal);
    file["images"] = {{{"uri", "colour.png"}}, {{"uri", "rough.png"}}, {{"uri", "normal.png"}}};
    file["textures"] = {{{"source", 0}}, {{"source", 1}}, {{"source", 2}}};
    Json& face = file["materials"][0];
    face["pbrMetallicRoughness"]["baseColorTexture"] = {{"index", 0}};
    face["pbrMetallicRoughness"]["metallicRoughnessTexture"] = {{"index", 1}};
    face["normalTexture"] = {{"index", 2}};
  }

  void add_nodes(Json& file) {
    Json nodes = Json::array();
    if (!o_.skin) {
      nodes.push_back({{"mesh", 0}});
      file["scenes"] = {{{"nodes", {0}}}};
      file["nodes"] = nodes;
      return;
    }
    const Vec3d places[kCount] = {{0, 1, 0},          {0, 1.3, 0},     {0, 1.48, 0},
                                  {0, 1.54, 0.01},    {0, 1.55, 0.04}, {0.03, 1.62, 0.1},
                                  {-0.03, 1.62, 0.1}, {0.25, 1.35, 0}, {-0.25, 1.35, 0}};
    const int parents[kCount] = {-1, kHips, kChest, kNeck, kHead, kHead, kHead, kChest, kChest};
    const char* names[kCount] = {"mixamorig:Hips",     "mixamorig:Spine",   "mixamorig:Neck",
                                 "mixamorig:Head",     "mixamorig:Jaw",     "mixamorig:LeftEye",
                                 "mixamorig:RightEye", "mixamorig:LeftArm", "mixamorig:RightArm"};
    std::vector<float> inverse;
    for (int j = 0; j < kCount; ++j) {
      std::string joint = names[j];
      const bool face = j >= kJaw && j <= kEyeR, limb = j >= kArmL;
      if ((face && !o_.face_joints) || (limb && !o_.body)) joint = "helper" + std::to_string(j);
      const Vec3f p = placed(places[j]),
                  up = parents[j] < 0 ? Vec3f(Vec3f::Zero()) : placed(places[parents[j]]);
      Json node = {{"name", joint},
                   {"translation", {p.x() - up.x(), p.y() - up.y(), p.z() - up.z()}}};
      for (int k = 0; k < kCount; ++k)
        if (parents[k] == j) node["children"].push_back(k);
      nodes.push_back(node);
      for (int i = 0; i < 16; ++i)
        inverse.push_back(i % 5 == 0 ? 1.0f : i >= 12 ? -p[i - 12] : 0.0f);
    }
    nodes.push_back({{"mesh", 0}, {"skin", 0}});
    file["nodes"] = nodes;
    file["scenes"] = {{{"nodes", {kHips, kCount}}}};
    file["skins"] = {{{"joints", {0, 1, 2, 3, 4, 5, 6, 7, 8}},
                      {"inverseBindMatrices", accessor(raw(inverse), 5126, kCount, "MAT4")}}};
  }

  TinyHeadOptions o_;
  std::string bytes_;
  Json accessors_ = Json::array(), views_ = Json::array();
};

}  // namespace effigy::test
