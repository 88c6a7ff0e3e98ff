#include "effigy/base/pickle.h"

#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <unordered_map>

#include "effigy/base/error.h"
#include "effigy/base/pickle_objects.h"
#include "effigy/base/utf8.h"

namespace effigy {

using pickle_detail::damaged_pickle;
using pickle_detail::Global;

namespace {

using Kind = PickleValue::Kind;

constexpr size_t kMostValues = 1'000'000;
constexpr size_t kMostSteps = 8'000'000;
constexpr size_t kMostLine = 1 << 20;

// The pickle opcodes that only build data (Python's pickletools has the full list).
enum Opcode : uint8_t {
  kMark = '(',
  kStop = '.',
  kPop = '0',
  kPopMark = '1',
  kDup = '2',
  kFloatText = 'F',
  kIntText = 'I',
  kInt4 = 'J',
  kInt1 = 'K',
  kLongText = 'L',
  kInt2 = 'M',
  kNoneValue = 'N',
  kPersistentId = 'Q',
  kReduce = 'R',
  kStringText = 'S',
  kString4 = 'T',
  kString1 = 'U',
  kUnicodeText = 'V',
  kUnicode4 = 'X',
  kAppend = 'a',
  kBuild = 'b',
  kGlobalText = 'c',
  kDictMark = 'd',
  kEmptyDict = '}',
  kAppends = 'e',
  kGetText = 'g',
  kGet1 = 'h',
  kGet4 = 'j',
  kListMark = 'l',
  kEmptyList = ']',
  kPutText = 'p',
  kPut1 = 'q',
  kPut4 = 'r',
  kSetItem = 's',
  kTupleMark = 't',
  kEmptyTuple = ')',
  kSetItems = 'u',
  kDouble = 'G',
  kBytes4 = 'B',
  kBytes1 = 'C',
  kProto = 0x80,
  kNewObject = 0x81,
  kTuple1 = 0x85,
  kTuple2 = 0x86,
  kTuple3 = 0x87,
  kTrue = 0x88,
  kFalse = 0x89,
  kLong1 = 0x8a,
  kLong4 = 0x8b,
  kUnicode1 = 0x8c,
  kUnicode8 = 0x8d,
  kBytes8 = 0x8e,
  kEmptySet = 0x8f,
  kAddItems = 0x90,
  kFrozen = 0x91,
  kStackGlobal = 0x93,
  kMemoize = 0x94,
  kFrame = 0x95,
  kByteArray8 = 0x96,
};

}  // namespace

// The stack machine. Values live in the Pickle and are shared by pointer, so neither building nor
// freeing them recurses, however deeply they are nested.
class PickleMachine {
 public:
  PickleMachine(std::span<const uint8_t> bytes, const std::string& file, PickleDialect dialect)
      : bytes_(bytes), file_(file), dialect_(dialect) {}

  Pickle run() {
    for (size_t step = 0; step < kMostSteps; ++step)
      if (!execute(byte())) return std::move(pickle_);
    damaged_pickle(file_, "more steps than any model file takes");
  }

 private:
  // Reading.
  std::span<const uint8_t> take(uint64_t count) {
    if (count > bytes_.size() - at_) damaged_pickle(file_, "truncated");
    const auto taken = bytes_.subspan(at_, static_cast<size_t>(count));
    at_ += static_cast<size_t>(count);
    return taken;
  }
  uint8_t byte() { return take(1)[0]; }
  uint64_t unsigned_integer(size_t width) {
    uint64_t value = 0;
    const auto taken = take(width);
    for (size_t i = 0; i < width; ++i) value |= uint64_t{taken[i]} << (8 * i);
    return value;
  }
  std::string line() {
    const size_t limit = std::min(bytes_.size(), at_ + kMostLine);
    size_t end = at_;
    while (end < limit && bytes_[end] != '\n') ++end;
    if (end == limit) damaged_pickle(file_, "a line without end");
    const std::string text(reinterpret_cast<const char*>(bytes_.data()) + at_, end - at_);
    at_ = end + 1;
    return text;
  }
  template <typename Number>
  Number number(const std::string& text) {
    Number value{};
    const char* end = text.data() + text.size();
    const auto [stop, code] = std::from_chars(text.data(), end, value);
    if (code != std::errc() || stop != end) damaged_pickle(file_, "a number that is none");
    return value;
  }

  // The stack.
  PickleValue* make(Kind kind) {
    if (pickle_.values_.size() >= kMostValues)
      damaged_pickle(file_, "more objects than any model file has");
    PickleValue& value = pickle_.values_.emplace_back();
    value.kind = kind;
    return &value;
  }
  PickleValue* push(PickleValue* value) {
    stack_.push_back(value);
    return value;
  }
  PickleValue* push_new(Kind kind) { return push(make(kind)); }
  void push_integer(int64_t value, Kind kind = Kind::kInt) { push_new(kind)->integer = value; }
  void push_string(Kind kind, std::span<const uint8_t> text) {
    push_new(kind)->text.assign(reinterpret_cast<const char*>(text.data()), text.size());
  }
  PickleValue* top() {
    if (stack_.size() <= floor()) damaged_pickle(file_, "an empty stack");
    return stack_.back();
  }
  PickleValue* pop() {
    PickleValue* value = top();
    stack_.pop_back();
    return value;
  }
  size_t floor() const { return marks_.empty() ? 0 : marks_.back(); }
  // Everything above the last mark, which is removed.
  std::vector<const PickleValue*> pop_to_mark() {
    if (marks_.empty()) damaged_pickle(file_, "a missing mark");
    const auto begin = stack_.begin() + static_cast<std::ptrdiff_t>(marks_.back());
    std::vector<const PickleValue*> items(begin, stack_.end());
    stack_.erase(begin, stack_.end());
    marks_.pop_back();
    return items;
  }
  void push_tuple(size_t count) {
    std::vector<const PickleValue*> items(count);
    for (size_t i = count; i-- > 0;) items[i] = pop();
    push_new(Kind::kTuple)->items = std::move(items);
  }

  // The memo.
  void put(uint64_t index) {
    if (memo_.size() >= kMostValues) damaged_pickle(file_, "too large a memo");
    memo_[index] = top();
  }
  void get(uint64_t index) {
    const auto found = memo_.find(index);
    if (found == memo_.end()) damaged_pickle(file_, "a reference to nothing");
    push(found->second);
  }

  void extend(Kind kind, const std::vector<const PickleValue*>& items) {
    PickleValue* target = top();
    if (target->kind != kind || (kind == Kind::kDict && items.size() % 2 != 0))
      damaged_pickle(file_, "items for something that takes none");
    target->items.insert(target->items.end(), items.begin(), items.end());
  }

  void push_global(const std::string& module, const std::string& name) {
    const Global global = pickle_detail::known_global(dialect_, module, name, file_);
    pickle_.globals_.insert(module + "." + name);
    PickleValue* value = push_new(Kind::kGlobal);
    value->integer = static_cast<int64_t>(global);
    value->text = name;
  }
  const PickleValue& pop_global() {
    const PickleValue* value = pop();
    if (value->kind != Kind::kGlobal) damaged_pickle(file_, "a call of something that is no name");
    return *value;
  }
  void push_persistent() {
    if (dialect_ != PickleDialect::kTorch)
      damaged_pickle(file_, "a reference to data outside of it");
    const PickleValue* identifier = pop();
    push_new(Kind::kPersistent)->items = {identifier};
  }

  // Little-endian two's complement of `width` bytes.
  void push_long(uint64_t width) {
    const auto taken = take(width);
    if (width > 9 || (width == 9 && taken[8] != 0))
      damaged_pickle(file_, "an integer of more than 64 bits");
    uint64_t value = !taken.empty() && taken.back() & 0x80 ? ~uint64_t{0} : 0;
    for (size_t i = std::min<size_t>(taken.size(), 8); i-- > 0;) value = value << 8 | taken[i];
    push_integer(static_cast<int64_t>(value));
  }

  void push_double() {
    uint64_t bits = 0;
    for (const uint8_t part : take(8)) bits = bits << 8 | part;  // big-endian
    push_new(Kind::kFloat)->number = std::bit_cast<double>(bits);
  }

  // Python 2's repr of a string: quotes around, backslash escapes inside.
  std::string unquoted(const std::string& text) {
    if (text.size() < 2 || (text[0] != '\'' && text[0] != '"') || text.back() != text[0])
      damaged_pickle(file_, "a string without quotes");
    std::string result;
    for (size_t i = 1; i + 1 < text.size(); ++i) {
      if (text[i] != '\\') {
        result += text[i];
        continue;
      }
      const char c = text[++i];
      if (c == 'x') {
        unsigned value = 0;
        const char* begin = text.data() + i + 1;
        if (i + 3 >= text.size() || std::from_chars(begin, begin + 2, value, 16).ptr != begin + 2)
          damaged_pickle(file_, "a damaged escape in a string");
        result += static_cast<char>(value);
        i += 2;
      } else {
        const size_t known = std::string_view("ntr\\'\"").find(c);
        if (known == std::string_view::npos || i + 1 >= text.size())
          damaged_pickle(file_, "a damaged escape in a string");
        result += "\n\t\r\\'\""[known];
      }
    }
    return result;
  }

  // Latin-1 with \uXXXX and \UXXXXXXXX, as UTF-8.
  std::string raw_unicode(const std::string& text) {
    std::string result;
    for (size_t i = 0; i < text.size(); ++i) {
      const bool escape =
          text[i] == '\\' && i + 1 < text.size() && (text[i + 1] == 'u' || text[i + 1] == 'U');
      uint32_t code = static_cast<uint8_t>(text[i]);
      if (escape) {
        const size_t digits = text[i + 1] == 'u' ? 4 : 8;
        const char* begin = text.data() + i + 2;
        if (i + 2 + digits > text.size() ||
            std::from_chars(begin, begin + digits, code, 16).ptr != begin + digits)
          damaged_pickle(file_, "a damaged escape in a text");
        i += 1 + digits;
      }
      append_utf8(code, result);
    }
    return result;
  }

  bool execute(uint8_t opcode) {
    return execute_value(opcode) || execute_string(opcode) || execute_container(opcode) ||
           execute_object(opcode);
  }

  // Each group returns true when it knew the opcode; the last one decides about stopping.
  bool execute_value(uint8_t opcode) {
    switch (opcode) {
      case kNoneValue:
        push_new(Kind::kNone);
        return true;
      case kTrue:
        push_integer(1, Kind::kBool);
        return true;
      case kFalse:
        push_integer(0, Kind::kBool);
        return true;
      case kInt1:
        push_integer(byte());
        return true;
      case kInt2:
        push_integer(static_cast<int64_t>(unsigned_integer(2)));
        return true;
      case kInt4:
        push_integer(static_cast<int32_t>(unsigned_integer(4)));
        return true;
      case kLong1:
        push_long(byte());
        return true;
      case kLong4:
        push_long(unsigned_integer(4));
        return true;
      case kIntText: {
        const std::string text = line();
        if (text == "00" || text == "01")
          push_integer(text == "01", Kind::kBool);
        else
          push_integer(number<int64_t>(text));
        return true;
      }
      case kLongText: {
        std::string text = line();
        if (!text.empty() && text.back() == 'L') text.pop_back();
        push_integer(number<int64_t>(text));
        return true;
      }
      case kFloatText:
        push_new(Kind::kFloat)->number = number<double>(line());
        return true;
      case kDouble:
        push_double();
        return true;
      default:
        return false;
    }
  }

  bool execute_string(uint8_t opcode) {
    switch (opcode) {
      case kStringText:
        push_new(Kind::kBytes)->text = unquoted(line());
        return true;
      case kUnicodeText:
        push_new(Kind::kText)->text = raw_unicode(line());
        return true;
      case kString1:
      case kBytes1:
        push_string(Kind::kBytes, take(byte()));
        return true;
      case kString4:
      case kBytes4:
        push_string(Kind::kBytes, take(unsigned_integer(4)));
        return true;
      case kBytes8:
      case kByteArray8:
        push_string(Kind::kBytes, take(unsigned_integer(8)));
        return true;
      case kUnicode1:
        push_string(Kind::kText, take(byte()));
        return true;
      case kUnicode4:
        push_string(Kind::kText, take(unsigned_integer(4)));
        return true;
      case kUnicode8:
        push_string(Kind::kText, take(unsigned_integer(8)));
        return true;
      default:
        return false;
    }
  }

  bool execute_container(uint8_t opcode) {
    switch (opcode) {
      case kMark:
        marks_.push_back(stack_.size());
        return true;
      case kPop:
        // POP on an empty frame removes the mark, as in Python.
        if (stack_.size() <= floor() && !marks_.empty())
          marks_.pop_back();
        else
          pop();
        return true;
      case kPopMark:
        pop_to_mark();
        return true;
      case kDup:
        push(top());
        return true;
      case kEmptyList:
        push_new(Kind::kList);
        return true;
      case kEmptyTuple:
        push_new(Kind::kTuple);
        return true;
      case kEmptyDict:
        push_new(Kind::kDict);
        return true;
      case kEmptySet:
        push_new(Kind::kSet);
        return true;
      case kListMark:
        push_marked(Kind::kList);
        return true;
      case kTupleMark:
        push_marked(Kind::kTuple);
        return true;
      case kFrozen:
        push_marked(Kind::kSet);
        return true;
      case kDictMark: {
        auto items = pop_to_mark();
        push_new(Kind::kDict);
        extend(Kind::kDict, items);
        return true;
      }
      case kTuple1:
        push_tuple(1);
        return true;
      case kTuple2:
        push_tuple(2);
        return true;
      case kTuple3:
        push_tuple(3);
        return true;
      case kAppend:
        extend_one(Kind::kList, 1);
        return true;
      case kSetItem:
        extend_one(Kind::kDict, 2);
        return true;
      case kAppends:
        extend_marked(Kind::kList);
        return true;
      case kSetItems:
        extend_marked(Kind::kDict);
        return true;
      case kAddItems:
        extend_marked(Kind::kSet);
        return true;
      default:
        return false;
    }
  }
  void push_marked(Kind kind) {
    auto items = pop_to_mark();
    push_new(kind)->items = std::move(items);
  }
  void extend_marked(Kind kind) {
    const auto items = pop_to_mark();
    extend(kind, items);
  }
  void extend_one(Kind kind, size_t count) {
    std::vector<const PickleValue*> items(count);
    for (size_t i = count; i-- > 0;) items[i] = pop();
    extend(kind, items);
  }

  bool execute_object(uint8_t opcode) {
    switch (opcode) {
      case kProto:
        if (byte() > 5) damaged_pickle(file_, "a protocol newer than 5");
        return true;
      case kFrame:
        take(8);
        return true;
      case kPutText:
        put(number<uint64_t>(line()));
        return true;
      case kPut1:
        put(byte());
        return true;
      case kPut4:
        put(unsigned_integer(4));
        return true;
      case kMemoize:
        put(memo_.size());
        return true;
      case kGetText:
        get(number<uint64_t>(line()));
        return true;
      case kGet1:
        get(byte());
        return true;
      case kGet4:
        get(unsigned_integer(4));
        return true;
      case kGlobalText: {
        const std::string module = line();
        push_global(module, line());
        return true;
      }
      case kStackGlobal: {
        const PickleValue* name = pop();
        const PickleValue* module = pop();
        if (!name->is_string() || !module->is_string())
          damaged_pickle(file_, "a name that is no text");
        push_global(module->text, name->text);
        return true;
      }
      case kReduce:
      case kNewObject: {
        const PickleValue* arguments = pop();
        const PickleValue& global = pop_global();
        PickleValue* result = push_new(Kind::kNone);
        if (opcode == kReduce)
          pickle_detail::call_global(global, *arguments, *result, budget_, file_);
        else
          pickle_detail::new_instance(static_cast<Global>(global.integer), *arguments, *result,
                                      file_);
        return true;
      }
      case kPersistentId:
        push_persistent();
        return true;
      case kBuild: {
        const PickleValue* state = pop();
        pickle_detail::build_object(*top(), *state, budget_, file_);
        return true;
      }
      case kStop:
        pickle_.root_ = pop();
        pickle_.size_ = at_;
        return false;
      default:
        damaged_pickle(file_, "the step " + std::to_string(opcode) +
                                  ", which is unknown or never needed in model files");
    }
  }

  std::span<const uint8_t> bytes_;
  const std::string& file_;
  PickleDialect dialect_;
  size_t at_ = 0;
  Pickle pickle_;
  std::vector<PickleValue*> stack_;
  std::vector<size_t> marks_;
  std::unordered_map<uint64_t, PickleValue*> memo_;
  pickle_detail::Budget budget_;
};

std::vector<double> CscMatrix::dense() const {
  std::vector<double> matrix(static_cast<size_t>(rows * columns), 0.0);
  for (int64_t column = 0; column < columns; ++column)
    for (int64_t i = starts[static_cast<size_t>(column)];
         i < starts[static_cast<size_t>(column) + 1]; ++i) {
      const int64_t row = row_indices[static_cast<size_t>(i)];
      // Repeated entries add up, as in scipy.
      matrix[static_cast<size_t>(row * columns + column)] += values[static_cast<size_t>(i)];
    }
  return matrix;
}

const PickleValue* PickleValue::find(const std::string& key) const {
  if (kind != Kind::kDict) return nullptr;
  const PickleValue* found = nullptr;
  for (size_t i = 0; i + 1 < items.size(); i += 2)
    if (items[i]->is_string() && items[i]->text == key) found = items[i + 1];  // the last one wins
  return found;
}

Pickle parse_pickle(std::span<const uint8_t> bytes, const std::string& name,
                    PickleDialect dialect) {
  return PickleMachine(bytes, name, dialect).run();
}

Pickle read_pickle(const Path& path) {
  const std::vector<uint8_t> bytes = read_file(path, uint64_t{1} << 30);
  return parse_pickle(bytes, path.string());
}

}  // namespace effigy
