// Writes state_dicts the way torch.save does, in both containers.
#pragma once

#include <zip.h>

#include <functional>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "base/pickle_writer.h"
#include "support.h"

namespace effigy::test {

struct TorchEntry {
  std::string name;
  std::vector<int64_t> shape;
  std::vector<float> values;          // of the whole storage
  std::vector<int64_t> strides = {};  // empty: C order
  int64_t offset = 0;
};
using TorchState = std::vector<TorchEntry>;

// What files of different ages and makers vary in.
struct TorchForm {
  bool zip = true;
  bool python2 = false;     // the dictionary from a list of pairs, byte strings (the LPIPS heads)
  bool parameters = false;  // torch.nn.parameter.Parameter around each tensor
  bool first_version = false;  // _rebuild_tensor instead of _rebuild_tensor_v2
  std::string type = "FloatStorage";
  std::function<std::string(const std::vector<float>&)> encode;  // for other types
};

class TorchWriter {
 public:
  explicit TorchWriter(TorchForm form) : form_(std::move(form)) {}

  // The pickled dictionary.
  std::string pickle(const TorchState& state) {
    bytes_ = std::string("\x80\x02");
    op("ccollections\nOrderedDict\n");
    if (form_.python2) {
      op("](");
      for (size_t i = 0; i < state.size(); ++i) {
        op("](");
        text(state[i].name);
        tensor(state[i], i);
        op("e");
      }
      op("e\x85R");
    } else {
      op(")R(");
      for (size_t i = 0; i < state.size(); ++i) {
        text(state[i].name);
        tensor(state[i], i);
      }
      op("u");
    }
    op("}");
    text("_metadata");
    op("}sb.");
    return bytes_;
  }

  void write(const TorchState& state, const Path& path) {
    const std::string root = pickle(state);
    if (form_.zip) {
      std::vector<std::pair<std::string, std::string>> entries = {{"net/data.pkl", root},
                                                                  {"net/byteorder", "little"}};
      for (size_t i = 0; i < state.size(); ++i)
        entries.emplace_back("net/data/" + key(i), encoded(state[i].values));
      entries.emplace_back("net/version", "3\n");
      write_entries(entries, path);
      return;
    }
    write_text(path, legacy(root, state));
  }

  std::string legacy(const std::string& root, const TorchState& state) {
    std::string file("\x80\x02\x8a\x0a\x6c\xfc\x9c\x46\xf9\x20\x6a\xa8\x50\x19.", 15);
    file += std::string("\x80\x02M\xe9\x03.", 6);
    bytes_ = std::string("\x80\x02}(");
    text("protocol_version");
    op(std::string("M\xe9\x03", 3));
    text("little_endian");
    op("\x88u.");
    file += bytes_ + root;
    bytes_ = std::string("\x80\x02](");
    for (size_t i = 0; i < state.size(); ++i) text(key(i));
    op("e.");
    file += bytes_;
    for (const TorchEntry& entry : state) {
      const auto count = static_cast<int64_t>(entry.values.size());
      file.append(reinterpret_cast<const char*>(&count), 8);
      file += encoded(entry.values);
    }
    return file;
  }

  static void write_entries(const std::vector<std::pair<std::string, std::string>>& entries,
                            const Path& path) {
    int code = 0;
    zip_t* archive = zip_open(path.c_str(), ZIP_CREATE | ZIP_TRUNCATE, &code);
    ASSERT_NE(archive, nullptr);
    for (const auto& [name, bytes] : entries) {
      const zip_int64_t index =
          zip_file_add(archive, name.c_str(),
                       zip_source_buffer(archive, bytes.data(), bytes.size(), 0), ZIP_FL_OVERWRITE);
      zip_set_file_compression(archive, static_cast<zip_uint64_t>(index), ZIP_CM_STORE, 0);
    }
    ASSERT_EQ(zip_close(archive), 0);
  }

 private:
  void op(const std::string& part) { bytes_ += part; }
  void integer(uint64_t value, int width) {
    for (int i = 0; i < width; ++i) bytes_ += static_cast<char>(value >> (8 * i));
  }
  void text(const std::string& value) {
    op(form_.python2 ? "T" : "X");
    integer(value.size(), 4);
    bytes_ += value;
  }
  void number(int64_t value) {
    op("J");
    integer(static_cast<uint64_t>(value), 4);
  }
  static std::string key(size_t i) { return std::to_string(100 + i); }
  std::string encoded(const std::vector<float>& values) const {
    if (form_.encode) return form_.encode(values);
    return {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(float)};
  }

  void tensor(const TorchEntry& entry, size_t i) {
    if (form_.parameters) op("ctorch.nn.parameter\nParameter\n(");
    op(form_.first_version ? "ctorch._utils\n_rebuild_tensor\n(("
                           : "ctorch._utils\n_rebuild_tensor_v2\n((");
    text("storage");
    op("ctorch\n" + form_.type + "\n");
    text(key(i));
    text("cuda:0");
    number(static_cast<int64_t>(entry.values.size()));
    op(form_.zip ? "tQ" : "NtQ");
    number(entry.offset);
    op("(");
    for (const int64_t side : entry.shape) number(side);
    op("t(");
    int64_t stride = 1;
    for (const int64_t side : entry.shape) stride *= side;
    for (size_t d = 0; d < entry.shape.size(); ++d) {
      stride /= entry.shape[d];
      number(entry.strides.empty() ? stride : entry.strides[d]);
    }
    op(form_.first_version ? "ttR" : "t\x89NtR");
    if (form_.parameters) op("tR(\x88\x89}tb");
  }

  TorchForm form_;
  std::string bytes_;
};

inline void write_torch(const TorchState& state, const Path& path, const TorchForm& form = {}) {
  TorchWriter(form).write(state, path);
}

}  // namespace effigy::test
