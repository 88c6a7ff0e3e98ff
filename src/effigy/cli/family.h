// Commands that heads and bodies share look at what their arguments name before they read them.
#pragma once

#include <string>

namespace effigy {

// Whether the first argument that is the folder of an avatar (of a capture) is of this kind, "head"
// or "body". False when there is none. Throws Error for folders that are neither.
bool names_avatar(int argc, char** argv, const std::string& kind);
bool names_capture(int argc, char** argv, const std::string& kind);

}  // namespace effigy
