#include "effigy/rig/canonical_face.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "effigy/base/error.h"

namespace effigy {

namespace {

constexpr size_t kVertices = 468;
constexpr size_t kFloatsPerVertex = 5;
constexpr size_t kMostIndices = 3 * 4096;
constexpr float kMetresPerUnit = 0.01f;

// Protobuf wire format, just what Mesh3d needs.
class Reader {
 public:
  explicit Reader(std::span<const uint8_t> bytes) : bytes_(bytes) {}
  bool done() const { return at_ >= bytes_.size(); }

  bool varint(uint64_t& value) {
    value = 0;
    for (int shift = 0; shift < 64 && at_ < bytes_.size(); shift += 7) {
      const uint8_t byte = bytes_[at_++];
      value |= static_cast<uint64_t>(byte & 0x7f) << shift;
      if (byte < 0x80) return true;
    }
    return false;
  }
  bool fixed32(float& value) {
    if (bytes_.size() - at_ < 4) return false;
    std::memcpy(&value, bytes_.data() + at_, 4);
    at_ += 4;
    return true;
  }
  bool message(std::span<const uint8_t>& inner) {
    uint64_t length = 0;
    if (!varint(length) || length > bytes_.size() - at_) return false;
    inner = bytes_.subspan(at_, length);
    at_ += length;
    return true;
  }

 private:
  std::span<const uint8_t> bytes_;
  size_t at_ = 0;
};

// Mesh3d { vertex_type = 1, primitive_type = 2, repeated float vertex_buffer = 3,
// repeated uint32 index_buffer = 4 }, repeated fields packed or not.
bool parse_mesh(std::span<const uint8_t> bytes, CanonicalFace& face) {
  std::vector<float> buffer;
  std::vector<uint64_t> indices;
  Reader reader(bytes);
  while (!reader.done()) {
    uint64_t key = 0, value = 0;
    if (!reader.varint(key)) return false;
    std::span<const uint8_t> inner;
    float number = 0;
    switch (key) {
      case (1 << 3) | 0:
      case (2 << 3) | 0:
        if (!reader.varint(value) || value != 0) return false;  // positions + UVs, triangles
        break;
      case (3 << 3) | 5:
        if (!reader.fixed32(number)) return false;
        buffer.push_back(number);
        break;
      case (4 << 3) | 0:
        if (!reader.varint(value)) return false;
        indices.push_back(value);
        break;
      case (3 << 3) | 2: {
        if (!reader.message(inner)) return false;
        Reader packed(inner);
        while (!packed.done()) {
          if (!packed.fixed32(number)) return false;
          buffer.push_back(number);
        }
        break;
      }
      case (4 << 3) | 2: {
        if (!reader.message(inner)) return false;
        Reader packed(inner);
        while (!packed.done()) {
          if (!packed.varint(value)) return false;
          indices.push_back(value);
        }
        break;
      }
      default:
        return false;
    }
    if (buffer.size() > kVertices * kFloatsPerVertex || indices.size() > kMostIndices) return false;
  }
  if (buffer.size() != kVertices * kFloatsPerVertex || indices.empty() || indices.size() % 3 != 0)
    return false;
  for (const float x : buffer)
    if (!std::isfinite(x) || std::abs(x) > 1e4f) return false;
  for (const uint64_t i : indices)
    if (i >= kVertices) return false;
  for (size_t v = 0; v < kVertices; ++v) {
    const float* p = buffer.data() + kFloatsPerVertex * v;
    face.vertices.emplace_back(kMetresPerUnit * Vec3f(p[0], p[1], p[2]));
    face.uvs.emplace_back(p[3], p[4]);
  }
  for (size_t i = 0; i < indices.size(); i += 3)
    face.triangles.emplace_back(static_cast<int>(indices[i]), static_cast<int>(indices[i + 1]),
                                static_cast<int>(indices[i + 2]));
  return true;
}

bool ends_with(const std::string& text, const std::string& end) {
  return text.size() >= end.size() && text.compare(text.size() - end.size(), end.size(), end) == 0;
}

}  // namespace

CanonicalFace parse_canonical_face(std::span<const uint8_t> bytes) {
  // GeometryPipelineMetadata.canonical_mesh: key 0x0a, a length, then the mesh, which begins with
  // its two enumerations, both zero, and a float.
  constexpr uint8_t kBegin[] = {0x08, 0x00, 0x10, 0x00};
  for (size_t at = 0; at + 16 < bytes.size(); ++at) {
    if (bytes[at] != 0x0a) continue;
    size_t body = at + 1;
    while (body < bytes.size() && body < at + 5 && bytes[body] >= 0x80) ++body;
    ++body;
    if (body + sizeof(kBegin) > bytes.size() ||
        std::memcmp(bytes.data() + body, kBegin, sizeof(kBegin)) != 0)
      continue;
    Reader reader(bytes.subspan(at + 1));
    std::span<const uint8_t> mesh;
    CanonicalFace face;
    if (reader.message(mesh) && parse_mesh(mesh, face)) return face;
  }
  return {};
}

CanonicalFace find_canonical_face(const Path& models) {
  std::error_code ignored;
  if (models.empty()) return {};
  if (std::filesystem::is_regular_file(models, ignored)) {
    CanonicalFace face = parse_canonical_face(read_file(models));
    if (face.empty())
      throw Error(models.string() +
                  ": holds no canonical face mesh; give face_landmarker.task or the "
                  "packed_assets.data of @mediapipe/face_mesh.");
    return face;
  }
  for (const char* below : {"", "@mediapipe/face_mesh", "node_modules/@mediapipe/face_mesh"}) {
    std::vector<Path> files;
    const Path folder = *below ? models / below : models;
    for (const auto& entry : std::filesystem::directory_iterator(folder, ignored)) {
      const std::string name = entry.path().filename().string();
      if (entry.is_regular_file(ignored) &&
          (ends_with(name, "geometry_pipeline_metadata_landmarks.binarypb") ||
           ends_with(name, "face_landmarker.task") || ends_with(name, "packed_assets.data")))
        files.push_back(entry.path());
    }
    std::sort(files.begin(), files.end());
    for (const Path& file : files) {
      CanonicalFace face = parse_canonical_face(read_file(file));
      if (!face.empty()) return face;
    }
  }
  return {};
}

}  // namespace effigy
