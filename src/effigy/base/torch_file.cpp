#include "effigy/base/torch_file.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <fstream>
#include <span>

#include "effigy/base/error.h"
#include "effigy/base/half.h"
#include "effigy/base/pickle.h"
#include "effigy/base/zip_archive.h"

namespace effigy {
namespace {

static_assert(std::endian::native == std::endian::little);

using Kind = PickleValue::Kind;

constexpr uint64_t kMostPickle = uint64_t{4} << 20;   // names and shapes; VGG16's take 4 kB
constexpr uint64_t kMostStorage = uint64_t{1} << 30;  // bytes; VGG16's largest has 411 MB
constexpr size_t kMostSides = 8;
constexpr const char* kRemedy =
    "download it again, or save the network's state_dict() with torch.save";

// The first pickle of the older container: a 10-byte integer, after the opcode of the protocol.
constexpr std::array<uint8_t, 13> kLegacyMagic = {0x8a, 0x0a, 0x6c, 0xfc, 0x9c, 0x46, 0xf9,
                                                  0x20, 0x6a, 0xa8, 0x50, 0x19, 0x2e};
constexpr int64_t kLegacyProtocol = 1001;

[[noreturn]] void damaged(const Path& path, const std::string& why) {
  throw Error(path.string() + ": not a readable torch.save file (" + why + "); " + kRemedy + ".");
}

// Bytes of one number; 0 for an unknown type.
size_t number_bytes(const std::string& type) {
  if (type == "DoubleStorage" || type == "LongStorage") return 8;
  if (type == "FloatStorage" || type == "IntStorage") return 4;
  if (type == "HalfStorage" || type == "BFloat16Storage" || type == "ShortStorage") return 2;
  if (type == "CharStorage" || type == "ByteStorage" || type == "BoolStorage") return 1;
  return 0;
}

std::vector<uint8_t> read_range(const Path& path, uint64_t begin, uint64_t count) {
  std::ifstream stream(path, std::ios::binary);
  std::vector<uint8_t> bytes(count);
  stream.seekg(static_cast<std::streamoff>(begin));
  stream.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(count));
  if (!stream) damaged(path, "it cannot be read to its end");
  return bytes;
}

template <typename Bits>
Bits load(const uint8_t* at) {
  Bits bits;
  std::memcpy(&bits, at, sizeof(bits));
  return bits;
}

// How one number of a storage type becomes a float; null for types that are not floating point.
using Decode = float (*)(const uint8_t* at);
Decode decoder(const std::string& type) {
  if (type == "FloatStorage") return load<float>;
  if (type == "DoubleStorage")
    return [](const uint8_t* at) { return static_cast<float>(load<double>(at)); };
  if (type == "HalfStorage")
    return [](const uint8_t* at) { return static_cast<float>(half_to_double(load<uint16_t>(at))); };
  if (type == "BFloat16Storage")
    return
        [](const uint8_t* at) { return std::bit_cast<float>(uint32_t{load<uint16_t>(at)} << 16); };
  return nullptr;
}

}  // namespace

// Turns the pickled state_dict into storages and tensors whose every index has been checked.
class TorchDirectory {
 public:
  explicit TorchDirectory(TorchFile& file) : file_(file) {}

  void read(const PickleValue& root) {
    if (root.kind != Kind::kDict) fail("it holds no dictionary of tensors");
    for (size_t i = 0; i + 1 < root.items.size(); i += 2) {
      const PickleValue* key = root.items[i];
      const PickleValue* value = root.items[i + 1];
      // Parameters are tensors with a flag.
      if (is_call(*value, "_rebuild_parameter") || is_call(*value, "Parameter"))
        value = &argument(*value, 0);
      if (!key->is_string() ||
          !(is_call(*value, "_rebuild_tensor") || is_call(*value, "_rebuild_tensor_v2")))
        continue;  // counters and settings of training runs
      file_.tensors_[key->text] = tensor(*value);
    }
    if (file_.tensors_.empty()) fail("it holds no tensors by name");
  }

 private:
  [[noreturn]] void fail(const std::string& why) const { damaged(file_.path_, why); }

  static bool is_call(const PickleValue& value, const char* function) {
    return value.kind == Kind::kCall && value.text == function;
  }
  const PickleValue& argument(const PickleValue& call, size_t index) const {
    if (index >= call.items.size()) fail("a tensor without all its parts");
    return *call.items[index];
  }
  uint64_t length(const PickleValue& value) const {
    if (value.kind != Kind::kInt || value.integer < 0) fail("a length that is none");
    return static_cast<uint64_t>(value.integer);
  }
  std::vector<int64_t> lengths(const PickleValue& value) const {
    if ((value.kind != Kind::kTuple && value.kind != Kind::kList) ||
        value.items.size() > kMostSides)
      fail("a shape that is none");
    std::vector<int64_t> result;
    for (const PickleValue* item : value.items)
      result.push_back(static_cast<int64_t>(length(*item)));
    return result;
  }

  // (storage, offset, shape, strides, ...)
  TorchFile::Tensor tensor(const PickleValue& call) {
    TorchFile::Tensor tensor;
    tensor.storage = storage(argument(call, 0));
    tensor.offset = length(argument(call, 1));
    tensor.shape = lengths(argument(call, 2));
    tensor.strides = lengths(argument(call, 3));
    if (tensor.shape.size() != tensor.strides.size()) fail("a tensor without all its strides");
    // Neither the number of elements nor the last one's place may be outside of the storage.
    const uint64_t most = file_.storages_[tensor.storage].count;
    uint64_t elements = 1, last = tensor.offset;
    for (size_t d = 0; d < tensor.shape.size(); ++d) {
      const auto side = static_cast<uint64_t>(tensor.shape[d]);
      const auto stride = static_cast<uint64_t>(tensor.strides[d]);
      if (side == 0) fail("an empty tensor");
      if (side > most / elements || (side > 1 && stride > most / (side - 1)))
        fail("a tensor larger than its storage");
      elements *= side;
      last += (side - 1) * stride;
      if (last >= most) fail("a tensor outside of its storage");
    }
    if (last >= most) fail("a tensor outside of its storage");
    return tensor;
  }

  // ("storage", type, key, place, count[, view])
  size_t storage(const PickleValue& value) {
    if (value.kind != Kind::kPersistent || value.items[0]->kind != Kind::kTuple)
      fail("a tensor without a storage");
    const std::vector<const PickleValue*>& parts = value.items[0]->items;
    if (parts.size() < 5 || parts[0]->text != "storage" || parts[1]->kind != Kind::kGlobal ||
        !parts[2]->is_string())
      fail("a tensor without a storage");
    if (parts.size() > 5 && parts[5]->kind != Kind::kNone)
      fail("a view of another storage, which is not read");
    TorchFile::Storage storage;
    storage.key = parts[2]->text;
    storage.type = parts[1]->text;
    storage.count = length(*parts[4]);
    const size_t bytes = number_bytes(storage.type);
    if (bytes == 0 || storage.count == 0 || storage.count > kMostStorage / bytes)
      fail("a storage of impossible type or size");
    for (size_t i = 0; i < file_.storages_.size(); ++i) {
      const TorchFile::Storage& known = file_.storages_[i];
      if (known.key != storage.key) continue;
      if (known.type != storage.type || known.count != storage.count)
        fail("two storages of one name");
      return i;
    }
    file_.storages_.push_back(std::move(storage));
    return file_.storages_.size() - 1;
  }

  TorchFile& file_;
};

namespace {

// The older container: magic number, protocol, system, state_dict and the storages' keys as five
// pickles; then each storage as a 64-bit count and its numbers. Calls storage(key, count, begin).
template <typename ReadRoot, typename FoundStorage>
void read_legacy(const Path& path, uint64_t file_bytes, std::span<const uint8_t> head,
                 const ReadRoot& read_root, const FoundStorage& found_storage) {
  uint64_t at = 2 + kLegacyMagic.size();
  const auto next = [&] {
    Pickle pickle = parse_pickle(head.subspan(at), path.string(), PickleDialect::kTorch);
    at += pickle.size();
    return pickle;
  };
  if (next().root().integer != kLegacyProtocol) damaged(path, "an unknown protocol");
  const Pickle system = next();
  const PickleValue* little_endian = system.root().find("little_endian");
  if (little_endian == nullptr || little_endian->kind != Kind::kBool || little_endian->integer == 0)
    damaged(path, "written by a big-endian machine");
  const Pickle state = next();
  read_root(state.root());
  const Pickle keys = next();
  if (keys.root().kind != Kind::kList) damaged(path, "no list of its storages");
  for (const PickleValue* key : keys.root().items) {
    if (!key->is_string() || file_bytes - at < 8) damaged(path, "truncated");
    uint64_t count = 0;
    std::memcpy(&count, read_range(path, at, 8).data(), 8);
    at += 8;
    const uint64_t bytes = found_storage(key->text, count, at);
    if (bytes > file_bytes - at) damaged(path, "truncated");
    at += bytes;
  }
}

}  // namespace

TorchFile::TorchFile(const Path& path) : path_(path) {
  std::error_code problem;
  const uint64_t size = std::filesystem::file_size(path, problem);
  if (problem)
    throw Error(path.string() + ": cannot be read (" + problem.message() + "); check the path.");
  const std::vector<uint8_t> head = read_range(path, 0, std::min(size, kMostPickle));
  if (head.size() > 4 && std::memcmp(head.data(), "PK\3\4", 4) == 0) {
    archive_ = std::make_unique<ZipArchive>(path, "torch.save file", kRemedy);
    const std::string last = "data.pkl";
    for (const std::string& name : archive_->names())
      if (name.size() > last.size() && name.ends_with("/" + last))
        prefix_ = name.substr(0, name.size() - last.size());
    if (archive_->has(prefix_ + "constants.pkl"))
      damaged(path, "it is a TorchScript program, not a state_dict");
    if (archive_->has(prefix_ + "byteorder")) {
      const std::vector<uint8_t> order = archive_->read(prefix_ + "byteorder", 64);
      if (std::string(order.begin(), order.end()) != "little")
        damaged(path, "written by a big-endian machine");
    }
    const std::vector<uint8_t> bytes = archive_->read(prefix_ + last, kMostPickle);
    TorchDirectory(*this).read(parse_pickle(bytes, path.string(), PickleDialect::kTorch).root());
    for (const Storage& storage : storages_)
      if (!archive_->has(prefix_ + "data/" + storage.key))
        damaged(path, "the storage '" + storage.key.substr(0, 80) + "' is missing");
    return;
  }
  if (head.size() < 2 + kLegacyMagic.size() || head[0] != 0x80 || head[1] < 2 || head[1] > 3 ||
      std::memcmp(head.data() + 2, kLegacyMagic.data(), kLegacyMagic.size()) != 0)
    damaged(path, "it does not begin like one");
  std::vector<bool> found;
  read_legacy(
      path, size, head,
      [&](const PickleValue& root) {
        TorchDirectory(*this).read(root);
        found.assign(storages_.size(), false);
      },
      [&](const std::string& key, uint64_t count, uint64_t begin) -> uint64_t {
        for (size_t i = 0; i < storages_.size(); ++i) {
          if (storages_[i].key != key) continue;
          if (storages_[i].count != count) damaged(path, "a storage of another length than stated");
          storages_[i].begin = begin;
          found[i] = true;
          return count * number_bytes(storages_[i].type);
        }
        damaged(path, "a storage that no tensor uses");
      });
  if (std::find(found.begin(), found.end(), false) != found.end())
    damaged(path, "a storage is missing");
}

TorchFile::~TorchFile() = default;
TorchFile::TorchFile(TorchFile&&) noexcept = default;

std::vector<std::string> TorchFile::names() const {
  std::vector<std::string> names;
  for (const auto& [name, tensor] : tensors_) names.push_back(name);
  return names;
}

const std::vector<int64_t>& TorchFile::shape(const std::string& name) const {
  const auto found = tensors_.find(name);
  EFFIGY_CHECK(found != tensors_.end());
  return found->second.shape;
}

std::string TorchFile::sides(const std::vector<int64_t>& shape) {
  std::string text;
  for (const int64_t side : shape) text += (text.empty() ? "" : "x") + std::to_string(side);
  return text.empty() ? "a single number" : text;
}

std::vector<uint8_t> TorchFile::storage_bytes(const Storage& storage) const {
  const uint64_t bytes = storage.count * number_bytes(storage.type);
  if (!archive_) return read_range(path_, storage.begin, bytes);
  std::vector<uint8_t> data = archive_->read(prefix_ + "data/" + storage.key, bytes);
  if (data.size() != bytes) damaged(path_, "a storage of another length than stated");
  return data;
}

std::vector<float> TorchFile::read(const std::string& name) const {
  const auto found = tensors_.find(name);
  EFFIGY_CHECK(found != tensors_.end());
  const Tensor& tensor = found->second;
  const Storage& storage = storages_[tensor.storage];
  const Decode decode = decoder(storage.type);
  if (decode == nullptr) damaged(path_, "'" + name + "' holds no floating-point numbers");
  const std::vector<uint8_t> bytes = storage_bytes(storage);
  const size_t width = number_bytes(storage.type), sides = tensor.shape.size();
  size_t count = 1;
  for (const int64_t side : tensor.shape) count *= static_cast<size_t>(side);
  std::vector<float> values(count);
  std::vector<int64_t> index(sides, 0);
  uint64_t at = tensor.offset;
  for (float& value : values) {
    value = decode(bytes.data() + at * width);
    if (!std::isfinite(value)) damaged(path_, "'" + name + "' holds a value that is not finite");
    for (size_t d = sides; d-- > 0;) {
      at += static_cast<uint64_t>(tensor.strides[d]);
      if (++index[d] < tensor.shape[d]) break;
      at -= static_cast<uint64_t>(tensor.shape[d]) * static_cast<uint64_t>(tensor.strides[d]);
      index[d] = 0;
    }
  }
  return values;
}

}  // namespace effigy
