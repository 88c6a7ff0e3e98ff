// JSON files: parsing with errors that name file and field.
#pragma once

#include <nlohmann/json.hpp>

#include "effigy/base/error.h"
#include "effigy/base/file.h"

namespace effigy {

using Json = nlohmann::json;

// Parses the file; throws Error naming the file and the position when it is not JSON.
Json read_json(const Path& path);
// Writes pretty-printed JSON, beside and renamed.
void write_json(const Path& path, const Json& value);

// value.at(field) as T; throws Error("FILE: field 'x' is missing or not a T; ...").
template <typename T>
T json_field(const Json& object, const std::string& field, const Path& file) {
  try {
    return object.at(field).get<T>();
  } catch (const nlohmann::json::exception& problem) {
    throw Error(file.string() + ": field '" + field + "' is missing or has the wrong type (" +
                problem.what() + "); write the file again.");
  }
}
// As json_field, with `fallback` when the field is absent.
template <typename T>
T json_field_or(const Json& object, const std::string& field, const Path& file, T fallback) {
  if (!object.is_object() || !object.contains(field)) return fallback;
  return json_field<T>(object, field, file);
}

}  // namespace effigy
