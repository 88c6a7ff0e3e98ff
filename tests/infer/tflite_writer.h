// Writes small TFLite flatbuffers, so that the tests of infer/ need no file from outside.
#pragma once

#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

namespace effigy::test {

struct WrittenTensor {
  std::string name;
  std::vector<int32_t> shape;
  int type = 0;                // 0 float32, 1 float16 (bytes given), 2 int32
  std::vector<uint8_t> bytes;  // empty: computed
};

struct WrittenOption {
  int field;
  int size;  // 1 or 4 bytes
  int32_t value;
};

struct WrittenNode {
  int code;
  std::vector<int32_t> inputs, outputs;
  std::vector<WrittenOption> options;
  std::string custom;
  std::vector<uint8_t> custom_bytes;
};

struct WrittenNetwork {
  std::vector<WrittenTensor> tensors;
  std::vector<WrittenNode> nodes;
  std::vector<int32_t> inputs, outputs;

  // Adds a computed tensor, returns its index.
  int tensor(std::vector<int32_t> shape) {
    tensors.push_back({"t" + std::to_string(tensors.size()), std::move(shape), 0, {}});
    return static_cast<int>(tensors.size()) - 1;
  }
  template <typename T>
  int constant(std::vector<int32_t> shape, const std::vector<T>& values, int type) {
    WrittenTensor made{"c" + std::to_string(tensors.size()), std::move(shape), type, {}};
    made.bytes.resize(values.size() * sizeof(T));
    std::memcpy(made.bytes.data(), values.data(), made.bytes.size());
    tensors.push_back(std::move(made));
    return static_cast<int>(tensors.size()) - 1;
  }
  int floats(std::vector<int32_t> shape, const std::vector<float>& values) {
    return constant(std::move(shape), values, 0);
  }
  int ints(std::vector<int32_t> shape, const std::vector<int32_t>& values) {
    return constant(std::move(shape), values, 2);
  }

  std::vector<uint8_t> write() const;
};

// Forward-only writer: tables first, their children after, offsets patched.
class FlatWriter {
 public:
  struct Field {
    int index;
    int size;        // 1, 2 or 4
    uint32_t value;  // ignored for offsets, which are patched
  };
  std::vector<uint8_t> bytes;

  template <typename T>
  void put(T value) {
    const auto* data = reinterpret_cast<const uint8_t*>(&value);
    bytes.insert(bytes.end(), data, data + sizeof(T));
  }
  void align(size_t to) {
    while (bytes.size() % to != 0) bytes.push_back(0);
  }
  void patch(size_t slot) {
    const auto offset = static_cast<uint32_t>(bytes.size() - slot);
    std::memcpy(bytes.data() + slot, &offset, 4);
  }
  // Returns the position of each field's slot, in the order given.
  std::vector<size_t> table(const std::vector<Field>& fields) {
    align(4);
    int count = 0;
    for (const Field& field : fields) count = std::max(count, field.index + 1);
    const size_t vtable = bytes.size();
    std::vector<uint16_t> slots(count, 0);
    uint16_t end = 4;
    for (const Field& field : fields) {
      slots[field.index] = end;
      end = static_cast<uint16_t>(end + 4);
    }
    put<uint16_t>(static_cast<uint16_t>(4 + 2 * count));
    put<uint16_t>(end);
    for (const uint16_t slot : slots) put(slot);
    align(4);
    const size_t position = bytes.size();
    put<int32_t>(static_cast<int32_t>(position - vtable));
    std::vector<size_t> places;
    for (const Field& field : fields) {
      places.push_back(bytes.size());
      put<uint32_t>(field.value);
    }
    last_table = position;
    return places;
  }
  // Position of the last table, for patching references to it.
  size_t last_table = 0;
  void patch_to(size_t slot, size_t target) {
    const auto offset = static_cast<uint32_t>(target - slot);
    std::memcpy(bytes.data() + slot, &offset, 4);
  }
  template <typename T>
  void vector_at(size_t slot, const std::vector<T>& values) {
    align(4);
    patch(slot);
    put<uint32_t>(static_cast<uint32_t>(values.size()));
    for (const T value : values) put(value);
    align(4);
  }
  void text_at(size_t slot, const std::string& text) {
    vector_at(slot, std::vector<uint8_t>(text.begin(), text.end()));
  }
  // A vector of n offsets; returns the slots.
  std::vector<size_t> offsets_at(size_t slot, size_t n) {
    align(4);
    patch(slot);
    put<uint32_t>(static_cast<uint32_t>(n));
    std::vector<size_t> slots;
    for (size_t i = 0; i < n; ++i) {
      slots.push_back(bytes.size());
      put<uint32_t>(0);
    }
    return slots;
  }
};

inline std::vector<uint8_t> WrittenNetwork::write() const {
  FlatWriter out;
  out.put<uint32_t>(0);
  out.bytes.insert(out.bytes.end(), {'T', 'F', 'L', '3'});
  const auto root = out.table({{0, 4, 3}, {1, 4, 0}, {2, 4, 0}, {4, 4, 0}});
  out.patch_to(0, out.last_table);

  const auto code_slots = out.offsets_at(root[1], nodes.size());  // one code per node
  for (size_t n = 0; n < nodes.size(); ++n) {
    std::vector<FlatWriter::Field> fields = {{3, 4, static_cast<uint32_t>(nodes[n].code)}};
    if (!nodes[n].custom.empty()) fields.push_back({1, 4, 0});
    const auto places = out.table(fields);
    out.patch_to(code_slots[n], out.last_table);
    if (!nodes[n].custom.empty()) out.text_at(places[1], nodes[n].custom);
  }
  const auto buffer_slots = out.offsets_at(root[3], tensors.size() + 1);
  for (size_t b = 0; b <= tensors.size(); ++b) {
    const bool filled = b > 0 && !tensors[b - 1].bytes.empty();
    const auto places = out.table(filled ? std::vector<FlatWriter::Field>{{0, 4, 0}}
                                         : std::vector<FlatWriter::Field>{});
    out.patch_to(buffer_slots[b], out.last_table);
    if (filled) out.vector_at(places[0], tensors[b - 1].bytes);
  }
  const auto graph_slots = out.offsets_at(root[2], 1);
  const auto graph = out.table({{0, 4, 0}, {1, 4, 0}, {2, 4, 0}, {3, 4, 0}});
  out.patch_to(graph_slots[0], out.last_table);
  out.vector_at(graph[1], inputs);
  out.vector_at(graph[2], outputs);
  const auto tensor_slots = out.offsets_at(graph[0], tensors.size());
  for (size_t t = 0; t < tensors.size(); ++t) {
    const auto places = out.table({{0, 4, 0},
                                   {1, 1, static_cast<uint32_t>(tensors[t].type)},
                                   {2, 4, static_cast<uint32_t>(t + 1)},
                                   {3, 4, 0}});
    out.patch_to(tensor_slots[t], out.last_table);
    out.vector_at(places[0], tensors[t].shape);
    out.text_at(places[3], tensors[t].name);
  }
  const auto node_slots = out.offsets_at(graph[3], nodes.size());
  for (size_t n = 0; n < nodes.size(); ++n) {
    const WrittenNode& node = nodes[n];
    std::vector<FlatWriter::Field> fields = {
        {0, 4, static_cast<uint32_t>(n)}, {1, 4, 0}, {2, 4, 0}};
    if (!node.options.empty()) fields.push_back({4, 4, 0});
    if (!node.custom_bytes.empty()) fields.push_back({5, 4, 0});
    const auto places = out.table(fields);
    out.patch_to(node_slots[n], out.last_table);
    out.vector_at(places[1], node.inputs);
    out.vector_at(places[2], node.outputs);
    size_t next = 3;
    if (!node.options.empty()) {
      std::vector<FlatWriter::Field> options;
      for (const WrittenOption& option : node.options)
        options.push_back({option.field, option.size, static_cast<uint32_t>(option.value)});
      out.align(4);
      out.table(options);
      out.patch_to(places[next], out.last_table);
      ++next;
    }
    if (!node.custom_bytes.empty()) out.vector_at(places[next], node.custom_bytes);
  }
  return out.bytes;
}

}  // namespace effigy::test
