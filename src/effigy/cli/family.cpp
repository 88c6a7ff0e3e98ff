#include "effigy/cli/family.h"

#include "effigy/avatar/kind.h"
#include "effigy/capture/stage_capture.h"

namespace effigy {

bool names_avatar(int argc, char** argv, const std::string& kind) {
  for (int k = 1; k < argc; ++k)
    if (std::filesystem::exists(Path(argv[k]) / "avatar.json")) return avatar_kind(argv[k]) == kind;
  return false;
}

bool names_capture(int argc, char** argv, const std::string& kind) {
  for (int k = 1; k < argc; ++k)
    if (std::filesystem::exists(Path(argv[k]) / "capture.json"))
      return capture_kind(argv[k]) == kind;
  return false;
}

}  // namespace effigy
