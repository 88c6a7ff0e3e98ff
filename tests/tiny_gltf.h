// A small skinned glTF file.
#pragma once

#include <cstdint>
#include <initializer_list>
#include <string>

namespace effigy::test {

inline std::string base64(const std::string& bytes) {
  static const char* const kDigits =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  for (size_t i = 0; i < bytes.size(); i += 3) {
    uint32_t word = 0;
    for (size_t k = 0; k < 3; ++k)
      word = word << 8 | (i + k < bytes.size() ? static_cast<uint8_t>(bytes[i + k]) : 0);
    for (size_t k = 0; k < 4; ++k)
      out +=
          i + k <= bytes.size() && k <= bytes.size() - i ? kDigits[word >> (18 - 6 * k) & 63] : '=';
  }
  return out;
}

// A square of two triangles with two joints: the right half follows the second one.
inline std::string sound_gltf() {
  std::string bytes;
  const auto floats = [&](std::initializer_list<float> list) {
    for (const float x : list) bytes.append(reinterpret_cast<const char*>(&x), 4);
  };
  floats({0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0});              // 0: positions, 48
  floats({0.1f, 0.9f, 0.9f, 0.9f, 0.9f, 0.1f, 0.1f, 0.1f});  // 48: UVs, 32
  floats({1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0});  // 80: weights, 64
  for (const uint8_t j : {0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0})
    bytes += static_cast<char>(j);  // 144: joints, 16
  for (const uint16_t i : {0, 1, 2, 0, 2, 3})
    bytes.append(reinterpret_cast<const char*>(&i), 2);  // 160: indices, 12
  return R"({"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0,1]}],
"nodes":[{"mesh":0,"skin":0},{"name":"base","children":[2]},{"name":"tip","translation":[0.5,0,0]}],
"skins":[{"joints":[2,1]}],
"meshes":[{"name":"square","primitives":[{"attributes":{"POSITION":0,"TEXCOORD_0":1,"WEIGHTS_0":2,"JOINTS_0":3},"indices":4,"material":0}]}],
"materials":[{"name":"red","pbrMetallicRoughness":{"baseColorFactor":[0.8,0.1,0.2,1],"roughnessFactor":0.4}}],
"accessors":[{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3"},
{"bufferView":0,"byteOffset":48,"componentType":5126,"count":4,"type":"VEC2"},
{"bufferView":0,"byteOffset":80,"componentType":5126,"count":4,"type":"VEC4"},
{"bufferView":0,"byteOffset":144,"componentType":5121,"count":4,"type":"VEC4"},
{"bufferView":0,"byteOffset":160,"componentType":5123,"count":6,"type":"SCALAR"}],
"bufferViews":[{"buffer":0,"byteLength":172}],
"buffers":[{"byteLength":172,"uri":"data:application/octet-stream;base64,)" +
         base64(bytes) + "\"}]}";
}

}  // namespace effigy::test
