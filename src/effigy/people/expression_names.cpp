#include "effigy/people/expression_names.h"

#include <cctype>
#include <map>
#include <vector>

namespace effigy {
namespace {

constexpr const char* kPairs[] = {"browDown",    "browInnerUp",  "browOuterUp",    "cheekPuff",
                                  "cheekSquint", "eyeBlink",     "eyeLookDown",    "eyeLookIn",
                                  "eyeLookOut",  "eyeLookUp",    "eyeSquint",      "eyeWide",
                                  "mouthDimple", "mouthFrown",   "mouthLowerDown", "mouthPress",
                                  "mouthSmile",  "mouthStretch", "mouthUpperUp",   "noseSneer"};
constexpr const char* kSingle[] = {
    "jawForward",     "jawLeft",         "jawOpen",         "jawRight",   "mouthClose",
    "mouthFunnel",    "mouthLeft",       "mouthPucker",     "mouthRight", "mouthRollLower",
    "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper", "tongueOut"};

struct Alias {
  const char* name;  // plain, without side
  const char* expression;
  bool pair;
};
// Others' names that mean one of ARKit's and nothing else. The last ones are MakeHuman's, whose
// side stands in the middle.
constexpr Alias kAliases[] = {{"mouthopen", "jawOpen", false},
                              {"openmouth", "jawOpen", false},
                              {"blink", "eyeBlink", true},
                              {"eyesclosed", "eyeBlink", true},
                              {"eyeclosed", "eyeBlink", true},
                              {"eyeclose", "eyeBlink", true},
                              {"smile", "mouthSmile", true},
                              {"frown", "mouthFrown", true},
                              {"pucker", "mouthPucker", false},
                              {"kiss", "mouthPucker", false},
                              {"eyelookup", "eyeLookUp", true},
                              {"eyeslookup", "eyeLookUp", true},
                              {"eyeslookdown", "eyeLookDown", true},
                              {"mouthcornerpuller", "mouthSmile", true},
                              {"mouthdepression", "mouthFrown", true},
                              {"mouthretraction", "mouthStretch", true},
                              {"mouthcompression", "mouthPress", true},
                              {"mouthpursing", "mouthPucker", false},
                              {"mouthprotusion", "mouthFunnel", false}};
struct SideAlias {
  const char *before, *after, *expression;
};
constexpr SideAlias kSideAliases[] = {
    {"eye", "closure", "eyeBlink"},         {"eye", "slit", "eyeSquint"},
    {"eye", "openedup", "eyeWide"},         {"eyebrows", "down", "browDown"},
    {"eyebrows", "innerup", "browInnerUp"}, {"eyebrows", "externup", "browOuterUp"},
    {"nose", "elevation", "noseSneer"}};

std::string plain(const std::string& name) {
  std::string out;
  for (const char c : name)
    if (std::isalnum(static_cast<unsigned char>(c)))
      out += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return out;
}

// All known names, plain.
const std::map<std::string, std::string>& table() {
  static const std::map<std::string, std::string> known = [] {
    std::map<std::string, std::string> names;
    const auto add_pair = [&](const std::string& name, const std::string& expression) {
      names.emplace(name, expression);
      for (const auto& [side, spellings] :
           {std::pair{"_L", std::pair{"left", "l"}}, {"_R", {"right", "r"}}})
        for (const char* spelling : {spellings.first, spellings.second}) {
          names.emplace(name + spelling, expression + side);
          names.emplace(spelling + name, expression + side);
        }
    };
    for (const char* name : kPairs) add_pair(plain(name), name);
    for (const char* name : kSingle) names.emplace(plain(name), name);
    for (const Alias& alias : kAliases) {
      if (alias.pair)
        add_pair(alias.name, alias.expression);
      else
        names.emplace(alias.name, alias.expression);
    }
    for (const SideAlias& alias : kSideAliases)
      for (const auto& [side, ending] : {std::pair{"left", "_L"}, {"right", "_R"}})
        names.emplace(std::string(alias.before) + side + alias.after,
                      std::string(alias.expression) + ending);
    return names;
  }();
  return known;
}

}  // namespace

std::string known_expression(const std::string& name) {
  // The whole name, or what follows one of its separators: prefixes end there.
  for (size_t begin = 0; begin < name.size();) {
    const auto found = table().find(plain(name.substr(begin)));
    if (found != table().end()) return found->second;
    while (begin < name.size() && std::isalnum(static_cast<unsigned char>(name[begin]))) ++begin;
    while (begin < name.size() && !std::isalnum(static_cast<unsigned char>(name[begin]))) ++begin;
  }
  return "";
}

}  // namespace effigy
