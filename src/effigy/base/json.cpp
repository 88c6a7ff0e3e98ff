#include "effigy/base/json.h"

namespace effigy {

Json read_json(const Path& path) {
  const std::string text = read_text(path);
  try {
    return Json::parse(text);
  } catch (const Json::parse_error& problem) {
    throw Error(path.string() + ": not valid JSON (byte " + std::to_string(problem.byte) +
                "); write the file again.");
  }
}

void write_json(const Path& path, const Json& value) {
  write_text(path, value.dump(2, ' ', false, Json::error_handler_t::replace) + "\n");
}

}  // namespace effigy
