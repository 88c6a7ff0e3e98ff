#include "effigy/base/pickle_objects.h"

#include <algorithm>
#include <span>

#include "effigy/base/error.h"

namespace effigy::pickle_detail {
namespace {

using Kind = PickleValue::Kind;

struct KnownGlobal {
  const char* module;
  const char* name;
  Global global;
};
constexpr KnownGlobal kNumericGlobals[] = {
    {"numpy", "ndarray", Global::kNdarray},
    {"numpy", "dtype", Global::kDtype},
    {"numpy.core.multiarray", "_reconstruct", Global::kReconstruct},
    {"numpy._core.multiarray", "_reconstruct", Global::kReconstruct},
    {"numpy.core.multiarray", "scalar", Global::kScalar},
    {"numpy._core.multiarray", "scalar", Global::kScalar},
    {"numpy.core.numeric", "_frombuffer", Global::kFromBuffer},
    {"numpy._core.numeric", "_frombuffer", Global::kFromBuffer},
    {"scipy.sparse.csc", "csc_matrix", Global::kCscMatrix},
    {"scipy.sparse._csc", "csc_matrix", Global::kCscMatrix},
    {"chumpy.ch", "Ch", Global::kCh},
    {"chumpy", "Ch", Global::kCh},
    {"_codecs", "encode", Global::kEncode},
    {"copy_reg", "_reconstructor", Global::kReconstructor},
    {"copyreg", "_reconstructor", Global::kReconstructor},
    // chumpy objects of Python 2 carry a set in their state, old protocols name `object`.
    {"__builtin__", "object", Global::kObject},
    {"builtins", "object", Global::kObject},
    {"__builtin__", "set", Global::kSet},
    {"builtins", "set", Global::kSet},
    {"__builtin__", "frozenset", Global::kFrozenSet},
    {"builtins", "frozenset", Global::kFrozenSet},
};

constexpr KnownGlobal kTorchGlobals[] = {
    {"collections", "OrderedDict", Global::kOrderedDict},
    {"torch._utils", "_rebuild_tensor", Global::kTorchCall},
    {"torch._utils", "_rebuild_tensor_v2", Global::kTorchCall},
    {"torch._utils", "_rebuild_parameter", Global::kTorchCall},
    {"torch.nn.parameter", "Parameter", Global::kTorchCall},
    {"torch", "FloatStorage", Global::kTorchType},
    {"torch", "DoubleStorage", Global::kTorchType},
    {"torch", "HalfStorage", Global::kTorchType},
    {"torch", "BFloat16Storage", Global::kTorchType},
    {"torch", "LongStorage", Global::kTorchType},
    {"torch", "IntStorage", Global::kTorchType},
    {"torch", "ShortStorage", Global::kTorchType},
    {"torch", "CharStorage", Global::kTorchType},
    {"torch", "ByteStorage", Global::kTorchType},
    {"torch", "BoolStorage", Global::kTorchType},
};

// For messages: short and printable, whatever the file holds.
std::string printable(const std::string& text) {
  std::string result = text.substr(0, 80);
  for (char& c : result)
    if (c < 0x20 || c > 0x7E) c = '?';
  return result;
}

const PickleValue& argument(const PickleValue& arguments, size_t index, const std::string& file) {
  if (arguments.kind != Kind::kTuple || index >= arguments.items.size())
    damaged_pickle(file, "a call without its arguments");
  return *arguments.items[index];
}

std::vector<int64_t> shape_of(const PickleValue& value, const std::string& file) {
  if (value.kind != Kind::kTuple && value.kind != Kind::kList)
    damaged_pickle(file, "an array shape that is no tuple");
  std::vector<int64_t> shape;
  for (const PickleValue* item : value.items) {
    if (item->kind != Kind::kInt || item->integer < 0)
      damaged_pickle(file, "an impossible array shape");
    shape.push_back(item->integer);
  }
  return shape;
}

const std::string& type_of(const PickleValue& value, const std::string& file) {
  if (value.kind != Kind::kType) damaged_pickle(file, "an array without a number type");
  return value.text;
}

std::span<const uint8_t> memory_of(const PickleValue& value, const std::string& file) {
  if (!value.is_string()) damaged_pickle(file, "an array of Python objects, which are not read");
  return {reinterpret_cast<const uint8_t*>(value.text.data()), value.text.size()};
}

bool truth(const PickleValue& value, const std::string& file) {
  if (value.kind != Kind::kBool && value.kind != Kind::kInt)
    damaged_pickle(file, "a flag that is neither true nor false");
  return value.integer != 0;
}

void fill_array(PickleValue& result, const std::string& descr, std::vector<int64_t> shape,
                bool fortran_order, std::span<const uint8_t> memory, Budget& budget,
                const std::string& file) {
  budget.take(memory.size(), file);
  result.array = make_npy_array(descr, std::move(shape), fortran_order, memory, file);
  result.kind = Kind::kArray;
}

// unicode.encode("latin1"): Python 3 writes bytes so for old protocols.
void encode_latin1(const PickleValue& arguments, PickleValue& result, Budget& budget,
                   const std::string& file) {
  const PickleValue& input = argument(arguments, 0, file);
  if (input.kind != Kind::kText) damaged_pickle(file, "an encoding of something that is no text");
  if (arguments.items.size() > 1) {
    const std::string& codec = arguments.items[1]->text;
    if (codec != "latin1" && codec != "latin-1" && codec != "iso-8859-1")
      damaged_pickle(file, "an encoding other than latin1");
  }
  budget.take(input.text.size(), file);
  result.kind = Kind::kBytes;
  for (size_t i = 0; i < input.text.size(); ++i) {
    const auto c = static_cast<uint8_t>(input.text[i]);
    if (c < 0x80) {
      result.text += static_cast<char>(c);
      continue;
    }
    // Code points 0x80 to 0xFF are C2 80 .. C3 BF in UTF-8.
    const auto next = i + 1 < input.text.size() ? static_cast<uint8_t>(input.text[i + 1]) : 0;
    if ((c != 0xC2 && c != 0xC3) || (next & 0xC0) != 0x80)
      damaged_pickle(file, "a text outside latin1");
    result.text += static_cast<char>(((c & 3) << 6) | (next & 0x3F));
    ++i;
  }
}

// OrderedDict() or OrderedDict([[key, value], ...]).
void fill_dictionary(const PickleValue& arguments, PickleValue& result, Budget& budget,
                     const std::string& file) {
  result.kind = Kind::kDict;
  result.integer = static_cast<int64_t>(Global::kOrderedDict);
  if (arguments.kind == Kind::kTuple && arguments.items.empty()) return;
  const PickleValue& pairs = argument(arguments, 0, file);
  if (pairs.kind != Kind::kList) damaged_pickle(file, "a dictionary of something that is no list");
  budget.take(2 * sizeof(void*) * pairs.items.size(), file);
  for (const PickleValue* pair : pairs.items) {
    if ((pair->kind != Kind::kList && pair->kind != Kind::kTuple) || pair->items.size() != 2)
      damaged_pickle(file, "a dictionary of something that is no pair");
    result.items.insert(result.items.end(), pair->items.begin(), pair->items.end());
  }
}

// (3, byte order, subtype, names, fields, size, alignment, flags), of which only the order counts.
void build_type(PickleValue& type, const PickleValue& state, const std::string& file) {
  const PickleValue& order = argument(state, 1, file);
  for (size_t i = 2; i < std::min<size_t>(state.items.size(), 5); ++i)
    if (state.items[i]->kind != Kind::kNone)
      damaged_pickle(file, "a structured array, which is not read");
  if (!order.is_string() || order.text.size() != 1)
    damaged_pickle(file, "a number type without byte order");
  const size_t digits = type.text.find_first_not_of("<>|=");
  type.text = order.text + type.text.substr(digits == std::string::npos ? 0 : digits);
}

const NpyArray& array_field(const PickleValue& state, const char* key, const std::string& file) {
  const PickleValue* value = state.find(key);
  if (value == nullptr || value->kind != Kind::kArray)
    damaged_pickle(file, std::string("a sparse matrix without its array '") + key + "'");
  return value->array;
}

// Every index and length is checked, so that dense() needs no checks.
void build_sparse(PickleValue& matrix, const PickleValue& state, Budget& budget,
                  const std::string& file) {
  const PickleValue* shape_value = state.find("_shape");
  if (shape_value == nullptr) shape_value = state.find("shape");
  if (shape_value == nullptr) damaged_pickle(file, "a sparse matrix without a shape");
  const std::vector<int64_t> shape = shape_of(*shape_value, file);
  const NpyArray& data = array_field(state, "data", file);
  const NpyArray& indices = array_field(state, "indices", file);
  const NpyArray& starts = array_field(state, "indptr", file);
  budget.take(8 * (data.bytes.size() + indices.bytes.size() + starts.bytes.size()), file);
  CscMatrix& m = matrix.sparse;
  m.values = data.doubles();
  m.row_indices = indices.integers();
  m.starts = starts.integers();
  constexpr int64_t kLargest = int64_t{1} << 31;
  if (shape.size() != 2 || shape[0] > kLargest || shape[1] > kLargest)
    damaged_pickle(file, "a sparse matrix of an impossible shape");
  m.rows = shape[0];
  m.columns = shape[1];
  const auto entries = static_cast<int64_t>(m.values.size());
  bool good = m.row_indices.size() == m.values.size() &&
              static_cast<int64_t>(m.starts.size()) == m.columns + 1 && m.starts.front() == 0 &&
              m.starts.back() == entries && std::is_sorted(m.starts.begin(), m.starts.end());
  for (const int64_t row : m.row_indices) good = good && row >= 0 && row < m.rows;
  if (!good) damaged_pickle(file, "a sparse matrix whose indices do not fit");
  // dense() allocates this much.
  if (m.rows > 0 && m.columns > (int64_t{1} << 27) / m.rows)
    damaged_pickle(file, "a sparse matrix that is too large");
  matrix.kind = Kind::kSparse;
}

}  // namespace

void damaged_pickle(const std::string& file, const std::string& why) {
  throw Error(file + ": not a readable pickle file (" + why + "); download or convert it again.");
}

void Budget::take(uint64_t bytes, const std::string& file) {
  if (bytes > left) damaged_pickle(file, "its arrays take more than 512 MiB");
  left -= bytes;
}

Global known_global(PickleDialect dialect, const std::string& module, const std::string& global,
                    const std::string& file) {
  const std::span<const KnownGlobal> known_here =
      dialect == PickleDialect::kTorch ? std::span<const KnownGlobal>(kTorchGlobals)
                                       : std::span<const KnownGlobal>(kNumericGlobals);
  for (const KnownGlobal& known : known_here)
    if (module == known.module && global == known.name) return known.global;
  throw Error(file + ": this pickle asks for the Python object '" + printable(module) + "." +
              printable(global) +
              "', which no model file needs, so it was refused and nothing was executed; do not "
              "trust this file, and download the model again from its publisher.");
}

void call_global(const PickleValue& function, const PickleValue& arguments, PickleValue& result,
                 Budget& budget, const std::string& file) {
  const auto global = static_cast<Global>(function.integer);
  switch (global) {
    case Global::kReconstruct:  // (ndarray, (0,), 'b'): an empty array, completed later
      if (argument(arguments, 0, file).text != "ndarray")
        damaged_pickle(file, "a reconstruction of something that is no array");
      result.kind = Kind::kInstance;
      result.integer = static_cast<int64_t>(Global::kNdarray);
      return;
    case Global::kReconstructor: {  // (class, object, None)
      const PickleValue& type = argument(arguments, 0, file);
      if (type.kind != Kind::kGlobal) damaged_pickle(file, "a reconstruction without a class");
      new_instance(static_cast<Global>(type.integer), {}, result, file);
      return;
    }
    case Global::kDtype: {
      const PickleValue& descr = argument(arguments, 0, file);
      if (!descr.is_string() || descr.text.size() > 16)
        damaged_pickle(file, "an unknown number type");
      result.kind = Kind::kType;
      result.text = descr.text;
      return;
    }
    case Global::kScalar:
      fill_array(result, type_of(argument(arguments, 0, file), file), {}, false,
                 memory_of(argument(arguments, 1, file), file), budget, file);
      return;
    case Global::kFromBuffer: {  // (memory, dtype, shape, order)
      const PickleValue& order = argument(arguments, 3, file);
      if (order.text != "C" && order.text != "F")
        damaged_pickle(file, "an array in an unknown order");
      fill_array(result, type_of(argument(arguments, 1, file), file),
                 shape_of(argument(arguments, 2, file), file), order.text == "F",
                 memory_of(argument(arguments, 0, file), file), budget, file);
      return;
    }
    case Global::kEncode:
      encode_latin1(arguments, result, budget, file);
      return;
    case Global::kSet:
    case Global::kFrozenSet: {
      if (arguments.kind != Kind::kTuple) damaged_pickle(file, "a set that is none");
      result.kind = Kind::kSet;
      if (arguments.items.empty()) return;
      const PickleValue& items = *arguments.items[0];
      budget.take(sizeof(void*) * items.items.size(), file);
      if (items.kind == Kind::kList || items.kind == Kind::kTuple) result.items = items.items;
      return;
    }
    case Global::kCscMatrix:
    case Global::kCh:
      new_instance(global, arguments, result, file);
      return;
    case Global::kOrderedDict:
      fill_dictionary(arguments, result, budget, file);
      return;
    case Global::kTorchCall:
      if (arguments.kind != Kind::kTuple) damaged_pickle(file, "a call without its arguments");
      budget.take(sizeof(void*) * arguments.items.size(), file);
      result.kind = Kind::kCall;
      result.text = function.text;
      result.items = arguments.items;
      return;
    case Global::kNdarray:
    case Global::kObject:
    case Global::kTorchType:
      break;
  }
  damaged_pickle(file, "a call of something that is not called in model files");
}

void new_instance(Global type, const PickleValue& arguments, PickleValue& result,
                  const std::string& file) {
  if (type != Global::kCscMatrix && type != Global::kCh && type != Global::kObject)
    damaged_pickle(file, "an instance of a class that has none in model files");
  if (!arguments.items.empty())
    damaged_pickle(file, "an instance made with arguments, which is not read");
  result.kind = Kind::kInstance;
  result.integer = static_cast<int64_t>(type);
}

void build_object(PickleValue& instance, const PickleValue& state, Budget& budget,
                  const std::string& file) {
  if (instance.kind == Kind::kType) return build_type(instance, state, file);
  // The attributes of an OrderedDict (_metadata) and of a Parameter say nothing about the numbers.
  if (instance.kind == Kind::kCall ||
      (instance.kind == Kind::kDict &&
       instance.integer == static_cast<int64_t>(Global::kOrderedDict)))
    return;
  if (instance.kind != Kind::kInstance) damaged_pickle(file, "a state for something complete");
  // Objects with slots have a pair of states, the first of which is the usual one.
  const bool pair = state.kind == Kind::kTuple && state.items.size() == 2;
  const PickleValue& fields = pair ? *state.items[0] : state;
  switch (static_cast<Global>(instance.integer)) {
    case Global::kNdarray: {  // (version, shape, dtype, is_fortran, memory)
      if (state.kind != Kind::kTuple || state.items.size() < 4)
        damaged_pickle(file, "an incomplete array");
      const size_t first = state.items.size() - 4;  // very old ones have no version
      fill_array(instance, type_of(*state.items[first + 1], file),
                 shape_of(*state.items[first], file), truth(*state.items[first + 2], file),
                 memory_of(*state.items[first + 3], file), budget, file);
      return;
    }
    case Global::kCscMatrix:
      build_sparse(instance, fields, budget, file);
      return;
    case Global::kCh: {
      const PickleValue* x = fields.find("x");
      if (x == nullptr || x->kind != Kind::kArray)
        damaged_pickle(file, "a chumpy object without an array 'x'");
      budget.take(x->array.bytes.size(), file);
      instance.array = x->array;
      instance.kind = Kind::kArray;
      return;
    }
    default:
      damaged_pickle(file, "a state for an object that has none");
  }
}

}  // namespace effigy::pickle_detail
