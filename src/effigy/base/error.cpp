#include "effigy/base/error.h"

namespace effigy::detail {

void check_failed(const char* file, int line, const char* condition, const std::string& values) {
  std::string sentence = std::string("Internal error in ") + file + ":" + std::to_string(line) +
                         ": " + condition + " does not hold";
  if (!values.empty()) sentence += " (" + values + ")";
  throw Error(sentence + "; please report it.", Blame::kInternal);
}

}  // namespace effigy::detail
