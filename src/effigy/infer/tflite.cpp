#include "effigy/infer/tflite.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <map>

#include "effigy/base/error.h"

namespace effigy {
namespace {

constexpr int64_t kMostElements = int64_t{1} << 24;  // of one tensor
constexpr int64_t kMostInAll = int64_t{1} << 28;     // of all tensors together
constexpr uint32_t kMostTensors = 20000;

// A flatbuffer, every access checked.
class Buffer {
 public:
  Buffer(std::span<const uint8_t> bytes, const std::string& name) : bytes_(bytes), name_(name) {}

  [[noreturn]] void fail(const std::string& what) const {
    throw Error(name_ + ": not a sound TFLite network (" + what +
                "); replace it by the published file.");
  }

  template <typename T>
  T get(size_t position) const {
    if (position > bytes_.size() || bytes_.size() - position < sizeof(T))
      fail("an offset leaves the file");
    T value;
    std::memcpy(&value, bytes_.data() + position, sizeof(T));
    return value;
  }

  // Target of the offset stored at `position`.
  size_t follow(size_t position) const {
    const auto offset = get<uint32_t>(position);
    if (offset == 0 || offset > bytes_.size() - position) fail("an offset leaves the file");
    return position + offset;
  }

  std::span<const uint8_t> range(size_t position, size_t size) const {
    if (position > bytes_.size() || bytes_.size() - position < size)
      fail("an array leaves the file");
    return bytes_.subspan(position, size);
  }

 private:
  std::span<const uint8_t> bytes_;
  const std::string& name_;
};

// A table of a flatbuffer: fields by number, absent ones have a default.
class Table {
 public:
  Table(const Buffer& buffer, size_t position) : buffer_(&buffer), position_(position) {
    const int64_t vtable = static_cast<int64_t>(position) - buffer.get<int32_t>(position);
    if (vtable < 0) buffer.fail("a table's layout lies outside the file");
    vtable_ = static_cast<size_t>(vtable);
    size_ = buffer.get<uint16_t>(vtable_);
  }

  // Position of field `index`, 0 when absent.
  size_t field(int index) const {
    const size_t slot = 4 + 2 * static_cast<size_t>(index);
    if (slot + 2 > size_) return 0;
    const auto offset = buffer_->get<uint16_t>(vtable_ + slot);
    return offset == 0 ? 0 : position_ + offset;
  }
  template <typename T>
  T value(int index, T fallback) const {
    const size_t at = field(index);
    return at == 0 ? fallback : buffer_->get<T>(at);
  }
  // Start and length of a vector of elements of `element` bytes.
  std::pair<size_t, uint32_t> vector(int index, size_t element) const {
    const size_t at = field(index);
    if (at == 0) return {0, 0};
    const size_t start = buffer_->follow(at);
    const auto length = buffer_->get<uint32_t>(start);
    buffer_->range(start + 4, static_cast<size_t>(length) * element);
    return {start + 4, length};
  }
  std::vector<int32_t> ints(int index) const {
    const auto [start, length] = vector(index, 4);
    std::vector<int32_t> values(length);
    for (uint32_t i = 0; i < length; ++i)
      values[i] = buffer_->get<int32_t>(start + 4 * static_cast<size_t>(i));
    return values;
  }
  std::vector<Table> tables(int index) const {
    const auto [start, length] = vector(index, 4);
    if (length > kMostTensors) buffer_->fail("it lists too many tensors or operators");
    std::vector<Table> tables;
    tables.reserve(length);
    for (uint32_t i = 0; i < length; ++i)
      tables.emplace_back(*buffer_, buffer_->follow(start + 4 * static_cast<size_t>(i)));
    return tables;
  }
  std::span<const uint8_t> bytes(int index) const {
    const auto [start, length] = vector(index, 1);
    return length == 0 ? std::span<const uint8_t>() : buffer_->range(start, length);
  }
  std::string text(int index) const {
    const auto data = bytes(index);
    return std::string(data.begin(), data.end());
  }

 private:
  const Buffer* buffer_;
  size_t position_, vtable_ = 0, size_ = 0;
};

constexpr int kFloat32 = 0, kFloat16 = 1, kInt32 = 2;

struct OperatorCode {
  int builtin = 0;
  std::string custom;
};

std::vector<OperatorCode> read_codes(const Table& model) {
  std::vector<OperatorCode> codes;
  for (const Table& table : model.tables(1)) {
    OperatorCode code;
    // The builtin code moved from a byte (field 0) to an int (field 3); the larger one is valid.
    code.builtin = std::max<int>(table.value<int8_t>(0, 0), table.value<int32_t>(3, 0));
    code.custom = table.text(1);
    if (!code.custom.empty()) code.builtin = static_cast<int>(TfliteOp::kCustom);
    codes.push_back(std::move(code));
  }
  return codes;
}

void fill_constant(TfliteTensor& tensor, int type, std::span<const uint8_t> data,
                   const Buffer& buffer) {
  const size_t element = type == kFloat16 ? 2 : 4;
  const auto count = static_cast<size_t>(tensor.count());
  if (data.size() != count * element)
    buffer.fail("the constant '" + tensor.name + "' does not have the size of its shape");
  tensor.constant = true;
  if (type == kInt32) {
    tensor.ints.resize(count);
    std::memcpy(tensor.ints.data(), data.data(), data.size());
    return;
  }
  tensor.floats.resize(count);
  if (type == kFloat32) {
    std::memcpy(tensor.floats.data(), data.data(), data.size());
  } else {
    for (size_t i = 0; i < count; ++i)
      tensor.floats[i] =
          float_from_half(static_cast<uint16_t>(data[2 * i] | (data[2 * i + 1] << 8)));
  }
  for (const float value : tensor.floats)
    if (!std::isfinite(value))
      buffer.fail("the constant '" + tensor.name + "' has a value that is not finite");
}

std::vector<TfliteTensor> read_tensors(const Table& graph, const std::vector<Table>& buffers,
                                       const Buffer& buffer) {
  std::vector<TfliteTensor> tensors;
  int64_t total = 0;
  for (const Table& table : graph.tables(0)) {
    TfliteTensor tensor;
    tensor.name = table.text(3);
    int64_t count = 1;
    for (const int32_t side : table.ints(0)) {
      if (side < 1 || side > kMostElements || (count *= side) > kMostElements)
        buffer.fail("the tensor '" + tensor.name + "' has an impossible shape");
      tensor.shape.push_back(side);
    }
    if (tensor.shape.size() > 6) buffer.fail("the tensor '" + tensor.name + "' has too many axes");
    if ((total += count) > kMostInAll) buffer.fail("its tensors are too large");
    const int type = table.value<int8_t>(1, 0);
    if (type != kFloat32 && type != kFloat16 && type != kInt32)
      buffer.fail("the tensor '" + tensor.name + "' has the unsupported data type " +
                  std::to_string(type));
    if (table.field(6) != 0)
      buffer.fail("the tensor '" + tensor.name + "' is stored sparsely, which is not supported");
    tensor.integer = type == kInt32;
    const auto storage = table.value<uint32_t>(2, 0);
    if (storage >= buffers.size()) buffer.fail("a tensor names a buffer that does not exist");
    const auto data = buffers[storage].bytes(0);
    if (!data.empty()) fill_constant(tensor, type, data, buffer);
    tensors.push_back(std::move(tensor));
  }
  return tensors;
}

TfliteActivation activation_of(const Table& options, int field, const Buffer& buffer) {
  const int code = options.value<int8_t>(field, 0);
  if (code != 0 && code != 1 && code != 3)
    buffer.fail("the fused activation " + std::to_string(code) + " is not supported");
  return static_cast<TfliteActivation>(code);
}

int positive(const Table& options, int field, int fallback, const Buffer& buffer) {
  const auto value = options.value<int32_t>(field, fallback);
  if (value < 1 || value > 4096) buffer.fail("a stride, dilation or window is out of range");
  return value;
}

void read_options(TfliteNode& node, const Table& options, const Buffer& buffer) {
  const auto window = [&](bool depthwise) {
    node.same_padding = options.value<int8_t>(0, 0) == 0;
    node.stride_w = positive(options, 1, 1, buffer);
    node.stride_h = positive(options, 2, 1, buffer);
    const int shift = depthwise ? 1 : 0;
    node.activation = activation_of(options, 3 + shift, buffer);
    node.dilation_w = positive(options, 4 + shift, 1, buffer);
    node.dilation_h = positive(options, 5 + shift, 1, buffer);
  };
  switch (node.op) {
    case TfliteOp::kConv:
      window(false);
      break;
    case TfliteOp::kDepthwiseConv:
      window(true);
      break;
    case TfliteOp::kAveragePool:
    case TfliteOp::kMaxPool:
      node.same_padding = options.value<int8_t>(0, 0) == 0;
      node.stride_w = positive(options, 1, 1, buffer);
      node.stride_h = positive(options, 2, 1, buffer);
      node.filter_w = positive(options, 3, 1, buffer);
      node.filter_h = positive(options, 4, 1, buffer);
      node.activation = activation_of(options, 5, buffer);
      break;
    case TfliteOp::kAdd:
    case TfliteOp::kSub:
    case TfliteOp::kMul:
    case TfliteOp::kDiv:
      node.activation = activation_of(options, 0, buffer);
      break;
    case TfliteOp::kConcat:
      node.axis = options.value<int32_t>(0, 0);
      node.activation = activation_of(options, 1, buffer);
      break;
    case TfliteOp::kResizeBilinear:
      node.align_corners = options.value<uint8_t>(2, 0) != 0;
      node.half_pixel_centers = options.value<uint8_t>(3, 0) != 0;
      break;
    case TfliteOp::kMean:
    case TfliteOp::kSum:
      node.keep_dims = options.value<uint8_t>(0, 0) != 0;
      break;
    case TfliteOp::kStridedSlice:
      node.begin_mask = options.value<int32_t>(0, 0);
      node.end_mask = options.value<int32_t>(1, 0);
      node.ellipsis_mask = options.value<int32_t>(2, 0);
      node.new_axis_mask = options.value<int32_t>(3, 0);
      node.shrink_mask = options.value<int32_t>(4, 0);
      break;
    default:
      break;
  }
}

bool known(int builtin) {
  static const int codes[] = {0,  1,  2,  3,  4,  6,  14, 17, 18, 19, 21, 22, 23, 32,
                              34, 39, 40, 41, 42, 45, 54, 59, 74, 75, 76, 99, 117};
  return std::find(std::begin(codes), std::end(codes), builtin) != std::end(codes);
}

TfliteNode read_node(const Table& table, const std::vector<OperatorCode>& codes,
                     size_t tensor_count, const Buffer& buffer) {
  const auto code = table.value<uint32_t>(0, 0);
  if (code >= codes.size()) buffer.fail("an operator names a code that does not exist");
  if (!known(codes[code].builtin))
    buffer.fail("the operator " + std::to_string(codes[code].builtin) + " is not supported");
  TfliteNode node;
  node.op = static_cast<TfliteOp>(codes[code].builtin);
  node.custom = codes[code].custom;
  node.inputs = table.ints(1);
  node.outputs = table.ints(2);
  for (const int input : node.inputs)
    if (input < -1 || input >= static_cast<int>(tensor_count))
      buffer.fail("an operator reads a tensor that does not exist");
  for (const int output : node.outputs)
    if (output < 0 || output >= static_cast<int>(tensor_count))
      buffer.fail("an operator writes a tensor that does not exist");
  if (node.inputs.empty() || node.inputs[0] < 0 || node.outputs.size() != 1)
    buffer.fail("an operator lacks its input or has more than one output");
  const size_t at = table.field(4);
  if (at != 0) read_options(node, Table(buffer, buffer.follow(at)), buffer);
  const auto custom = table.bytes(5);
  node.custom_bytes.assign(custom.begin(), custom.end());
  return node;
}

// Half-precision constants reach their users through DEQUANTIZE: the result becomes a constant.
bool fold_dequantize(TfliteModel& model, const TfliteNode& node, const Buffer& buffer) {
  if (node.op != TfliteOp::kDequantize) return false;
  TfliteTensor& source = model.tensors[node.inputs[0]];
  TfliteTensor& result = model.tensors[node.outputs[0]];
  if (!source.constant || source.integer || result.constant || source.shape != result.shape)
    buffer.fail("a DEQUANTIZE is not that of a half-precision constant");
  result.constant = true;
  result.floats = source.floats;
  return true;
}

}  // namespace

int64_t TfliteTensor::count() const {
  int64_t count = 1;
  for (const int64_t side : shape) count *= side;
  return count;
}

float float_from_half(uint16_t half) {
  const uint32_t sign = static_cast<uint32_t>(half & 0x8000U) << 16;
  const uint32_t exponent = (half >> 10) & 31U;
  const uint32_t mantissa = half & 1023U;
  if (exponent == 31) return std::bit_cast<float>(sign | 0x7f800000U | (mantissa << 13));
  if (exponent == 0) {
    const float magnitude = static_cast<float>(mantissa) * 0x1.0p-24f;
    return sign != 0 ? -magnitude : magnitude;
  }
  return std::bit_cast<float>(sign | ((exponent + 112) << 23) | (mantissa << 13));
}

TfliteModel parse_tflite(std::span<const uint8_t> bytes, const std::string& name) {
  const Buffer buffer(bytes, name);
  if (bytes.size() < 8 || std::memcmp(bytes.data() + 4, "TFL3", 4) != 0)
    buffer.fail("the TFL3 mark is missing");
  const Table root(buffer, buffer.follow(0));
  const std::vector<Table> graphs = root.tables(2);
  if (graphs.size() != 1) buffer.fail("it has not exactly one graph");
  const std::vector<OperatorCode> codes = read_codes(root);

  TfliteModel model;
  model.tensors = read_tensors(graphs[0], root.tables(4), buffer);
  model.inputs = graphs[0].ints(1);
  model.outputs = graphs[0].ints(2);
  std::vector<bool> ready(model.tensors.size());
  for (const int input : model.inputs) {
    if (input < 0 || input >= static_cast<int>(ready.size()) || model.tensors[input].constant)
      buffer.fail("an input does not exist");
    ready[input] = true;
  }
  for (const Table& table : graphs[0].tables(3)) {
    TfliteNode node = read_node(table, codes, model.tensors.size(), buffer);
    for (const int input : node.inputs)
      if (input >= 0 && !model.tensors[input].constant && !ready[input])
        buffer.fail("an operator reads '" + model.tensors[input].name + "' before it is computed");
    const int output = node.outputs[0];
    if (ready[output] || model.tensors[output].constant)
      buffer.fail("'" + model.tensors[output].name + "' is computed twice");
    if (fold_dequantize(model, node, buffer)) continue;
    ready[output] = true;
    model.nodes.push_back(std::move(node));
  }
  if (model.inputs.empty() || model.outputs.empty()) buffer.fail("it has no input or no output");
  for (const int output : model.outputs)
    if (output < 0 || output >= static_cast<int>(ready.size()) || !ready[output])
      buffer.fail("an output is never computed");
  return model;
}

}  // namespace effigy
