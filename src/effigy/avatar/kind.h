// Which family an avatar folder belongs to.
#pragma once

#include <string>

#include "effigy/base/file.h"
#include "effigy/base/json.h"

namespace effigy {

// avatar.json, its version checked. Throws Error when the folder is no avatar.
Json read_avatar_json(const Path& folder);

// "head" or "body". Throws Error for others.
std::string avatar_kind(const Path& folder);

}  // namespace effigy
