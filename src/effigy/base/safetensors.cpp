#include "effigy/base/safetensors.h"

#include <cmath>
#include <cstring>

#include "effigy/base/json.h"

namespace effigy {
namespace {

struct TypeName {
  Tensor::Type type;
  const char* name;
  int64_t bytes;
};
constexpr TypeName kTypes[] = {
    {Tensor::Type::kF32, "F32", 4}, {Tensor::Type::kI32, "I32", 4}, {Tensor::Type::kU8, "U8", 1},
    {Tensor::Type::kI64, "I64", 8}, {Tensor::Type::kF64, "F64", 8}, {Tensor::Type::kF16, "F16", 2},
};

const TypeName& type_name(Tensor::Type type) {
  for (const auto& entry : kTypes)
    if (entry.type == type) return entry;
  throw Error("unknown tensor type", Blame::kInternal);
}

template <typename T>
Tensor make(Tensor::Type type, std::span<const T> values, std::vector<int64_t> shape) {
  Tensor tensor{type, std::move(shape), {}};
  EFFIGY_CHECK_EQ(tensor.count(), static_cast<int64_t>(values.size()));
  tensor.bytes.resize(values.size_bytes());
  if (!values.empty()) std::memcpy(tensor.bytes.data(), values.data(), values.size_bytes());
  return tensor;
}

template <typename T>
std::vector<T> unpack(const Tensor& tensor) {
  std::vector<T> values(static_cast<size_t>(tensor.count()));
  if (!values.empty()) std::memcpy(values.data(), tensor.bytes.data(), tensor.bytes.size());
  return values;
}

std::string shape_text(const std::vector<int64_t>& shape) {
  std::string text = "(";
  for (size_t i = 0; i < shape.size(); ++i)
    text += (i ? ", " : "") + (shape[i] < 0 ? std::string("any") : std::to_string(shape[i]));
  return text + ")";
}

[[noreturn]] void damaged(const Path& path, const std::string& why) {
  throw Error(path.string() + ": damaged safetensors file (" + why +
              "); write it again or restore a copy.");
}

Tensor parse_tensor(const Path& path, const std::string& name, const Json& entry,
                    std::span<const uint8_t> data) {
  Tensor tensor;
  const auto type = entry.at("dtype").get<std::string>();
  bool known = false;
  for (const auto& candidate : kTypes)
    if (type == candidate.name) {
      tensor.type = candidate.type;
      known = true;
    }
  if (!known) damaged(path, "tensor '" + name + "' has the unsupported type " + type);
  tensor.shape = entry.at("shape").get<std::vector<int64_t>>();
  const auto offsets = entry.at("data_offsets").get<std::vector<uint64_t>>();
  int64_t count = 1;
  for (int64_t length : tensor.shape) {
    if (length < 0 || (length > 0 && count > (int64_t{1} << 40) / length))
      damaged(path, "tensor '" + name + "' has an impossible shape");
    count *= length;
  }
  const auto expected = static_cast<uint64_t>(count * type_name(tensor.type).bytes);
  if (offsets.size() != 2 || offsets[0] > offsets[1] || offsets[1] > data.size() ||
      offsets[1] - offsets[0] != expected)
    damaged(path, "tensor '" + name + "' does not fit its data range");
  tensor.bytes.assign(data.begin() + static_cast<int64_t>(offsets[0]),
                      data.begin() + static_cast<int64_t>(offsets[1]));
  return tensor;
}

}  // namespace

int64_t Tensor::count() const {
  int64_t count = 1;
  for (int64_t length : shape) count *= length;
  return count;
}

Tensor Tensor::from(std::span<const float> values, std::vector<int64_t> shape) {
  return make(Type::kF32, values, std::move(shape));
}
Tensor Tensor::from(std::span<const int32_t> values, std::vector<int64_t> shape) {
  return make(Type::kI32, values, std::move(shape));
}
Tensor Tensor::from(std::span<const int64_t> values, std::vector<int64_t> shape) {
  return make(Type::kI64, values, std::move(shape));
}
Tensor Tensor::from(std::span<const uint8_t> values, std::vector<int64_t> shape) {
  return make(Type::kU8, values, std::move(shape));
}

const Tensor& TensorFile::find(const std::string& name, Tensor::Type type,
                               const std::vector<int64_t>& shape) const {
  const auto found = tensors.find(name);
  if (found == tensors.end())
    throw Error(path.string() + ": tensor '" + name + "' is missing; write the file again.");
  const Tensor& tensor = found->second;
  bool same = tensor.type == type && tensor.shape.size() == shape.size();
  for (size_t i = 0; same && i < shape.size(); ++i)
    same = shape[i] < 0 || shape[i] == tensor.shape[i];
  if (!same)
    throw Error(path.string() + ": tensor '" + name + "' is " + type_name(tensor.type).name +
                shape_text(tensor.shape) + ", expected " + type_name(type).name +
                shape_text(shape) + "; write the file again.");
  return tensor;
}

std::vector<float> TensorFile::floats(const std::string& name, std::vector<int64_t> shape) const {
  auto values = unpack<float>(find(name, Tensor::Type::kF32, shape));
  for (size_t i = 0; i < values.size(); ++i)
    if (!std::isfinite(values[i]))
      throw Error(path.string() + ": tensor '" + name +
                  "' has a value that is not finite (element " + std::to_string(i) +
                  "); write the file again.");
  return values;
}
std::vector<int32_t> TensorFile::ints(const std::string& name, std::vector<int64_t> shape) const {
  return unpack<int32_t>(find(name, Tensor::Type::kI32, shape));
}
std::vector<int64_t> TensorFile::longs(const std::string& name, std::vector<int64_t> shape) const {
  return unpack<int64_t>(find(name, Tensor::Type::kI64, shape));
}
std::vector<uint8_t> TensorFile::bytes(const std::string& name, std::vector<int64_t> shape) const {
  return unpack<uint8_t>(find(name, Tensor::Type::kU8, shape));
}
const std::vector<int64_t>& TensorFile::shape(const std::string& name) const {
  const auto found = tensors.find(name);
  if (found == tensors.end())
    throw Error(path.string() + ": tensor '" + name + "' is missing; write the file again.");
  return found->second.shape;
}

TensorFile read_safetensors(const Path& path) {
  const auto bytes = read_file(path, uint64_t{16} << 30);
  if (bytes.size() < 8) damaged(path, "shorter than its header");
  uint64_t header_size = 0;
  std::memcpy(&header_size, bytes.data(), 8);
  if (header_size > bytes.size() - 8 || header_size > (uint64_t{100} << 20))
    damaged(path, "its header is longer than the file");
  TensorFile file;
  file.path = path;
  const std::span<const uint8_t> data(bytes.data() + 8 + header_size,
                                      bytes.size() - 8 - header_size);
  try {
    const Json header =
        Json::parse(bytes.begin() + 8, bytes.begin() + 8 + static_cast<int64_t>(header_size));
    for (const auto& [name, entry] : header.items()) {
      if (name == "__metadata__") {
        file.metadata = entry.get<std::map<std::string, std::string>>();
      } else {
        file.tensors[name] = parse_tensor(path, name, entry, data);
      }
    }
  } catch (const nlohmann::json::exception& problem) {
    damaged(path, std::string("header: ") + problem.what());
  }
  return file;
}

void write_safetensors(const Path& path, const TensorFile& file) {
  Json header = Json::object();
  uint64_t offset = 0;
  for (const auto& [name, tensor] : file.tensors) {
    header[name] = {{"dtype", type_name(tensor.type).name},
                    {"shape", tensor.shape},
                    {"data_offsets", {offset, offset + tensor.bytes.size()}}};
    offset += tensor.bytes.size();
  }
  if (!file.metadata.empty()) header["__metadata__"] = file.metadata;
  std::string text = header.dump(-1, ' ', false, Json::error_handler_t::replace);
  while (text.size() % 8 != 0) text += ' ';
  std::vector<uint8_t> bytes(8 + text.size() + offset);
  const uint64_t header_size = text.size();
  std::memcpy(bytes.data(), &header_size, 8);
  std::memcpy(bytes.data() + 8, text.data(), text.size());
  size_t at = 8 + text.size();
  for (const auto& [name, tensor] : file.tensors) {
    if (!tensor.bytes.empty())
      std::memcpy(bytes.data() + at, tensor.bytes.data(), tensor.bytes.size());
    at += tensor.bytes.size();
  }
  write_file(path, bytes);
}

}  // namespace effigy
