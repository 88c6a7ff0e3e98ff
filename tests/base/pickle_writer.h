// Writes pickles the way Python does, in the two forms that FLAME's files have.
#pragma once

#include <cstdint>
#include <cstring>
#include <functional>
#include <string>
#include <vector>

namespace effigy::test {

class PickleWriter {
 public:
  // Protocol 2 as Python 2 writes it, or protocol 5 as NumPy 2 on Python 3 does.
  explicit PickleWriter(bool modern) : modern_(modern) {
    bytes = modern ? std::string("\x80\x05") : std::string("\x80\x02");
  }

  std::string bytes;

  std::vector<uint8_t> finish() {
    bytes += '.';
    return {bytes.begin(), bytes.end()};
  }

  void op(const std::string& text) { bytes += text; }
  void integer(uint64_t value, int width) {
    for (int i = 0; i < width; ++i) bytes += static_cast<char>(value >> (8 * i));
  }

  void text(const std::string& value) {
    op(modern_ ? "\x8c" : "U");
    integer(value.size(), 1);
    bytes += value;
    memoize();
  }
  void data(const void* memory, size_t size) {
    if (modern_) {
      op("\x96");  // bytearray
      integer(size, 8);
    } else {
      op("T");
      integer(size, 4);
    }
    bytes.append(static_cast<const char*>(memory), size);
    memoize();
  }
  void number(int64_t value) {
    if (value >= 0 && value < 256) {
      op("K");
      integer(static_cast<uint64_t>(value), 1);
    } else if (value >= INT32_MIN && value <= INT32_MAX) {
      op("J");
      integer(static_cast<uint64_t>(value), 4);
    } else {
      op("\x8a\x08");
      integer(static_cast<uint64_t>(value), 8);
    }
  }
  void global(const std::string& module, const std::string& name) {
    if (modern_) {
      text(module);
      text(name);
      op("\x93");
    } else {
      op("c" + module + "\n" + name + "\n");
    }
    memoize();
  }
  void shape(const std::vector<int64_t>& lengths) {
    op("(");
    for (const int64_t length : lengths) number(length);
    op("t");
    memoize();
  }
  // A dtype such as "<f8".
  void type(const std::string& descr) {
    global("numpy", "dtype");
    text(descr.substr(1));
    op(modern_ ? "\x89\x88\x87R" : "K");
    if (!modern_) op(std::string("\0K\1\x87R", 5));
    memoize();
    op("(K\3");
    text(descr.substr(0, 1));
    op("NNN");
    number(-1);
    number(-1);
    number(0);
    op("tb");
  }
  void array(const std::string& descr, const std::vector<int64_t>& lengths, const void* memory,
             size_t size, bool fortran = false) {
    if (modern_) {
      global("numpy._core.numeric", "_frombuffer");
      op("(");
      data(memory, size);
      type(descr);
      shape(lengths);
      text(fortran ? "F" : "C");
      op("tR");
      memoize();
      return;
    }
    global("numpy.core.multiarray", "_reconstruct");
    global("numpy", "ndarray");
    number(0);
    op("\x85");
    text("b");
    op("\x87R");
    memoize();
    op("(K\1");
    shape(lengths);
    type(descr);
    op(fortran ? "\x88" : "\x89");
    data(memory, size);
    op("tb");
  }
  template <typename T>
  void array(const std::string& descr, const std::vector<int64_t>& lengths,
             const std::vector<T>& values) {
    array(descr, lengths, values.data(), values.size() * sizeof(T));
  }
  void dictionary(const std::vector<std::pair<std::string, std::function<void()>>>& entries) {
    op("}");
    memoize();
    op("(");
    for (const auto& [key, write] : entries) {
      text(key);
      write();
    }
    op("u");
  }
  void instance(const std::string& module, const std::string& name,
                const std::vector<std::pair<std::string, std::function<void()>>>& state) {
    global(module, name);
    op(")\x81");
    memoize();
    dictionary(state);
    op("b");
  }
  // chumpy.Ch of doubles, with all the state that chumpy keeps.
  void chumpy(const std::vector<int64_t>& lengths, const std::vector<double>& values) {
    instance("chumpy.ch", "Ch",
             {{"_dirty_vars",
               [&] {
                 global("__builtin__", "set");
                 op("](");
                 text("x");
                 op("e\x85R");
               }},
              {"_itr", [&] { op("N"); }},
              {"_depends_on_deps", [&] { op("}"); }},
              {"x", [&] { array("<f8", lengths, values); }},
              {"_make_dense", [&] { op("\x89"); }}});
  }
  void csc(int64_t rows, int64_t columns, const std::vector<double>& values,
           const std::vector<int32_t>& indices, const std::vector<int32_t>& starts) {
    const auto n = static_cast<int64_t>(values.size());
    instance(modern_ ? "scipy.sparse._csc" : "scipy.sparse.csc", "csc_matrix",
             {{"_shape",
               [&] {
                 shape({rows, columns});
               }},
              {"maxprint", [&] { number(50); }},
              {"indices", [&] { array("<i4", {n}, indices); }},
              {"indptr", [&] { array("<i4", {columns + 1}, starts); }},
              {"data", [&] { array("<f8", {n}, values); }}});
  }

 private:
  void memoize() {
    if (modern_) {
      op("\x94");
    } else {
      op("r");
      integer(memo_++, 4);
    }
  }

  bool modern_;
  uint64_t memo_ = 0;
};

}  // namespace effigy::test
