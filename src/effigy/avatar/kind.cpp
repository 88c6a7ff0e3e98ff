#include "effigy/avatar/kind.h"

#include "effigy/base/error.h"

namespace effigy {
namespace {

constexpr int kFormatVersion = 1;

}  // namespace

Json read_avatar_json(const Path& folder) {
  const Path file = folder / "avatar.json";
  if (!std::filesystem::exists(file))
    throw Error(folder.string() +
                ": not an avatar (avatar.json is missing); make one with 'effigy train CAPTURE -o "
                "AVATAR'.");
  Json info = read_json(file);
  const int version = json_field<int>(info, "version", file);
  if (version != kFormatVersion)
    throw Error(file.string() + ": field 'version' is " + std::to_string(version) +
                ", this program reads version 1; update Effigy or train again.");
  return info;
}

std::string avatar_kind(const Path& folder) {
  auto kind = json_field<std::string>(read_avatar_json(folder), "kind", folder / "avatar.json");
  if (kind != "head" && kind != "body")
    throw Error((folder / "avatar.json").string() + ": field 'kind' must be head or body, not '" +
                kind + "'; correct it.");
  return kind;
}

}  // namespace effigy
