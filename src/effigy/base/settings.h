// Settings with names: one list of (name, value) serves reading and writing.
#pragma once

#include <set>
#include <string>
#include <type_traits>

#include "effigy/base/error.h"
#include "effigy/base/json.h"

namespace effigy {

// `list(settings, visit)` calls visit(name, reference) for every setting.
template <typename Settings, typename List>
Json settings_to_json(const Settings& settings, const List& list) {
  Json json = Json::object();
  list(settings, [&](const char* name, const auto& value) { json[name] = value; });
  return json;
}

// Fields that are missing keep their value; an unknown one is an error, because a misspelt setting
// must not be ignored. `name` is what the sentence starts with, `document` where settings are
// explained.
template <typename Settings, typename List>
void settings_from_json(const Json& json, const std::string& name, const std::string& document,
                        Settings& settings, const List& list) {
  if (!json.is_object()) throw Error(name + ": settings must be a JSON object.");
  std::set<std::string> known;
  list(settings, [&](const char* field, auto& value) {
    known.insert(field);
    if (json.contains(field)) value = json_field<std::decay_t<decltype(value)>>(json, field, name);
  });
  for (const auto& [field, value] : json.items())
    if (!known.count(field))
      throw Error(name + ": unknown setting '" + field + "'; see " + document + ".");
}

}  // namespace effigy
