// Python pickle files with numeric data, such as FLAME models and torch.save files, read without
// Python and without trusting them: a pickle is a program, and this reader carries out only the
// steps that build data.
//
// The few classes and functions it knows by name (all versions' spellings), by dialect:
//   kNumeric  numpy: ndarray, dtype, _reconstruct, scalar, _frombuffer; scipy.sparse: csc_matrix;
//             chumpy: Ch (its array); _codecs.encode; copyreg._reconstructor with object; set,
//             frozenset.
//   kTorch    collections.OrderedDict; torch: the storage types, _utils._rebuild_tensor,
//             _rebuild_tensor_v2, _rebuild_parameter, nn.parameter.Parameter. Calls of torch's are
//             only written down (PickleValue::Kind::kCall), and so are persistent references.
// Any other name is refused with a sentence that names it. Nothing is ever executed.
#pragma once

#include <deque>
#include <set>
#include <string>
#include <vector>

#include "effigy/base/npy.h"

namespace effigy {

// scipy's compressed sparse column matrix: column c has the entries starts[c] .. starts[c + 1].
struct CscMatrix {
  int64_t rows = 0, columns = 0;
  std::vector<double> values;
  std::vector<int64_t> row_indices;
  std::vector<int64_t> starts;        // columns + 1
  std::vector<double> dense() const;  // [rows][columns]
};

enum class PickleDialect { kNumeric, kTorch };

// One Python object. Lists may contain themselves, so do not walk a value without a limit.
struct PickleValue {
  enum class Kind {
    kNone,
    kBool,
    kInt,
    kFloat,
    kText,   // unicode, as UTF-8
    kBytes,  // bytes, and strings of Python 2
    kList,
    kTuple,
    kSet,   // items
    kDict,  // items: key, value, key, value, ...
    kArray,
    kSparse,
    kCall,        // kTorch: text is the name of the function, items its arguments
    kPersistent,  // kTorch: a reference to data outside of the pickle; items: its one identifier
    // Left over only in odd files:
    kGlobal,    // one of the known names: text is the last part of it
    kType,      // numpy.dtype
    kInstance,  // an object that was not completed
  };
  Kind kind = Kind::kNone;
  int64_t integer = 0;  // kBool, kInt
  double number = 0;    // kFloat
  std::string text;     // kText, kBytes; kGlobal, kCall: its name; kType: "<f8"
  std::vector<const PickleValue*> items;
  NpyArray array;    // kArray (also a completed chumpy.Ch)
  CscMatrix sparse;  // kSparse

  // The value of a text key in a dictionary; null when absent or not a dictionary.
  const PickleValue* find(const std::string& key) const;
  bool is_string() const { return kind == Kind::kText || kind == Kind::kBytes; }
};

// Owns all objects of one pickle.
class Pickle {
 public:
  const PickleValue& root() const { return *root_; }
  // The names that were used, such as "chumpy.ch.Ch".
  const std::set<std::string>& globals() const { return globals_; }
  // Bytes that the pickle takes; others may follow it.
  size_t size() const { return size_; }

 private:
  friend class PickleMachine;
  std::deque<PickleValue> values_;
  std::set<std::string> globals_;
  const PickleValue* root_ = nullptr;
  size_t size_ = 0;
};

// Protocols 0 to 5. Throws Error, beginning with `name`, for names that are not known, damaged
// data, and more than a million objects or 512 MiB of arrays.
Pickle parse_pickle(std::span<const uint8_t> bytes, const std::string& name,
                    PickleDialect dialect = PickleDialect::kNumeric);
Pickle read_pickle(const Path& path);

}  // namespace effigy
