// Which joint of any skeleton is which of a person's.
#pragma once

#include <map>
#include <string>
#include <vector>

namespace effigy {

// Joints by the built-in body's names: "hips", "spine", "chest", "upper_chest", "neck", "head" and,
// with _left and _right, "shoulder", "upper_arm", "lower_arm", "hand", "upper_leg", "lower_leg",
// "foot", "toes". Limbs, neck and head are found by their usual names (CMU, Mixamo, VRM, MakeHuman,
// Unreal, Rigify, 3ds Max; with any prefix before a colon); hips are where the legs meet, the spine
// is what lies between hips and neck. `parents`: -1 at roots, else smaller than the joint's number;
// joints with empty names are left out. What is not found is not in the map.
std::map<std::string, int> humanoid_joints(const std::vector<std::string>& names,
                                           const std::vector<int>& parents);

// The same for the face: "jaw", "eye_left", "eye_right".
std::map<std::string, int> face_joints(const std::vector<std::string>& names);

}  // namespace effigy
