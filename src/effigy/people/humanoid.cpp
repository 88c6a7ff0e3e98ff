#include "effigy/people/humanoid.h"

#include <algorithm>
#include <cctype>

namespace effigy {
namespace {

// Lower case without separators and without the prefixes that exporters add.
std::string plain_name(const std::string& name) {
  std::string out;
  for (const char c : name) {
    if (c == ':') out.clear();  // "mixamorig:Hips"
    if (std::isalnum(static_cast<unsigned char>(c)))
      out += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  }
  for (const std::string prefix : {"mixamorig", "bip"})
    if (out.starts_with(prefix)) {
      out.erase(0, prefix.size());
      while (!out.empty() && std::isdigit(static_cast<unsigned char>(out[0]))) out.erase(0, 1);
    }
  return out;
}

struct Names {
  const char* joint;
  std::vector<const char*> usual;  // the first found wins; {L} is "left" or "l"
};

const std::vector<Names>& middle_names() {
  static const std::vector<Names> table = {{"neck", {"neck", "neck01", "neck1", "necklower"}},
                                           {"head", {"head"}}};
  return table;
}

const std::vector<Names>& side_names() {
  static const std::vector<Names> table = {
      {"shoulder", {"{L}shoulder", "{L}collar", "{L}clavicle", "clavicle{L}", "shoulder{L}"}},
      {"upper_arm",
       {"{L}arm", "{L}upperarm", "upperarm01{L}", "shoulder02{L}", "upperarm{L}", "{L}shldr",
        "uparm{L}"}},
      {"lower_arm",
       {"{L}forearm", "{L}lowerarm", "lowerarm01{L}", "lowerarm{L}", "forearm{L}", "loarm{L}"}},
      {"hand", {"{L}hand", "wrist{L}", "hand{L}"}},
      {"upper_leg",
       {"{L}upleg", "{L}upperleg", "{L}thigh", "upperleg01{L}", "upperleg{L}", "thigh{L}",
        "upleg{L}"}},
      {"lower_leg",
       {"{L}leg", "{L}lowerleg", "{L}shin", "{L}calf", "lowerleg01{L}", "lowerleg{L}", "calf{L}",
        "shin{L}", "loleg{L}"}},
      {"foot", {"{L}foot", "foot{L}"}},
      {"toes",
       {"{L}toebase", "{L}toes", "{L}toe", "{L}toe0", "toe11{L}", "toes{L}", "ball{L}", "toe{L}"}}};
  return table;
}

const std::vector<Names>& face_names() {
  static const std::vector<Names> table = {
      {"jaw",
       {"jaw", "jawmaster", "jawroot", "jawbone", "jawjoint", "lowerjaw", "mandible", "cjaw",
        "facialcjaw", "jadjcjaw"}}};
  return table;
}

const std::vector<Names>& eye_names() {
  static const std::vector<Names> table = {
      {"eye",
       {"{L}eye", "eye{L}", "{L}eyeball", "eyeball{L}", "{L}eyejoint", "eyejoint{L}",
        "jadj{L}faceeye", "facial{L}eye"}}};
  return table;
}

class Finder {
 public:
  Finder(const std::vector<std::string>& names, const std::vector<int>& parents)
      : parents_(parents) {
    // Of two that differ in their separators only, the upper is a helper ("__UpLeg_L").
    for (size_t j = 0; j < names.size(); ++j)
      if (!names[j].empty()) by_name_[plain_name(names[j])] = static_cast<int>(j);
  }

  std::map<std::string, int> run() {
    find_middle(middle_names());
    find_sides(side_names());
    add_trunk();
    return std::move(found_);
  }

  std::map<std::string, int> run_face() {
    find_middle(face_names());
    find_sides(eye_names());
    return std::move(found_);
  }

 private:
  void find_middle(const std::vector<Names>& table) {
    for (const Names& names : table)
      for (const std::string usual : names.usual) take(names.joint, usual);
  }
  void find_sides(const std::vector<Names>& table) {
    for (const Names& names : table)
      for (const auto& [side, spellings] :
           {std::pair{"_left", std::pair{"left", "l"}}, {"_right", {"right", "r"}}})
        for (const std::string usual : names.usual)
          for (const char* spelling : {spellings.first, spellings.second})
            take(names.joint + std::string(side),
                 std::string(usual).replace(usual.find("{L}"), 3, spelling));
  }
  void take(const std::string& joint, const std::string& name) {
    const auto at = by_name_.find(name);
    if (at != by_name_.end()) found_.emplace(joint, at->second);
  }
  std::vector<int> above(int joint) const {  // itself first
    std::vector<int> path;
    for (; joint >= 0; joint = parents_[static_cast<size_t>(joint)]) path.push_back(joint);
    return path;
  }

  void add_trunk() {
    const auto left = found_.find("upper_leg_left"), right = found_.find("upper_leg_right");
    if (left == found_.end() || right == found_.end()) return;
    const std::vector<int> over_left = above(left->second), over_right = above(right->second);
    const auto meet = std::find_first_of(over_left.begin() + 1, over_left.end(),
                                         over_right.begin() + 1, over_right.end());
    if (meet == over_left.end()) return;
    found_["hips"] = *meet;
    const auto neck = found_.find("neck");
    if (neck == found_.end()) return;
    std::vector<int> spine = above(neck->second);
    const auto end = std::find(spine.begin(), spine.end(), *meet);
    if (end == spine.end()) return;
    spine = std::vector<int>(spine.begin() + 1, end);  // from the top down
    if (spine.size() == 1) found_["chest"] = spine[0];
    if (spine.size() < 2) return;
    found_["upper_chest"] = spine.front();
    found_["spine"] = spine.back();
    if (spine.size() > 2) found_["chest"] = spine[spine.size() / 2];
  }

  const std::vector<int>& parents_;
  std::map<std::string, int> by_name_, found_;
};

}  // namespace

std::map<std::string, int> humanoid_joints(const std::vector<std::string>& names,
                                           const std::vector<int>& parents) {
  return Finder(names, parents).run();
}

std::map<std::string, int> face_joints(const std::vector<std::string>& names) {
  const std::vector<int> no_parents;
  return Finder(names, no_parents).run_face();
}

}  // namespace effigy
