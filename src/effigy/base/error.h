// Errors. The library never prints, exits or aborts: it throws Error, and the command line turns
// one Error into one sentence and an exit code.
#pragma once

#include <stdexcept>
#include <string>
#include <type_traits>

namespace effigy {

// Who has to act on an error.
enum class Blame {
  kInput,     // usage or input: the file, value or option named in the message; exit code 2
  kResource,  // the machine: disk full, no permission, out of memory; exit code 1
  kInternal,  // a defect of Effigy; exit code 1
};

// One sentence that names the file and field, what is wrong, and what to do.
class Error : public std::runtime_error {
 public:
  explicit Error(const std::string& sentence, Blame blame = Blame::kInput)
      : std::runtime_error(sentence), blame_(blame) {}
  Blame blame() const { return blame_; }
  int exit_code() const { return blame_ == Blame::kInput ? 2 : 1; }

 private:
  Blame blame_;
};

// Thrown when the user interrupts long work (Ctrl-C); exit code 130.
class Interrupted : public Error {
 public:
  Interrupted() : Error("Interrupted.", Blame::kResource) {}
};

namespace detail {
[[noreturn]] void check_failed(const char* file, int line, const char* condition,
                               const std::string& values);
}  // namespace detail

// Programmer errors: conditions that only a defect of Effigy can break. Always compiled in.
#define EFFIGY_CHECK(condition)                                                           \
  do {                                                                                    \
    if (!(condition)) ::effigy::detail::check_failed(__FILE__, __LINE__, #condition, {}); \
  } while (false)

// Equality of two integers, printing both values when it fails.
#define EFFIGY_CHECK_EQ(a, b)                                                          \
  do {                                                                                 \
    const auto effigy_a = (a);                                                         \
    const auto effigy_b = (b);                                                         \
    if (!(effigy_a == static_cast<std::remove_const_t<decltype(effigy_a)>>(effigy_b))) \
      ::effigy::detail::check_failed(                                                  \
          __FILE__, __LINE__, #a " == " #b,                                            \
          std::to_string(effigy_a) + " vs " + std::to_string(effigy_b));               \
  } while (false)

}  // namespace effigy
