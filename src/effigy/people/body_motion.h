// Motions of bodies: exercises made by code, and the user's own BVH files.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "effigy/people/builtin_body.h"
#include "effigy/rig/bvh.h"

namespace effigy {

struct BodyMotion {
  double frames_per_second = 30;
  std::vector<RigPose> poses;  // of the built-in body: drive_body_helpers() done
};

// Every joint through its comfortable range at its own slow pace, hands and face included; smooth
// in time, a foot on the floor, deterministic by seed.
BodyMotion range_of_motion(const BuiltinBody& body, int frames, double frames_per_second,
                           uint64_t seed);
// What training has not seen: walking on the spot, waving, turning.
BodyMotion unseen_motion(const BuiltinBody& body, int frames, double frames_per_second,
                         uint64_t seed);

// Moves a body as the file's skeleton moves: bones point where the file's bones point, the lower
// foot stands on y = 0. Joints of both are found by their usual names (humanoid.h); those without a
// counterpart rest. The rig may face anywhere, y is up. Resampled to frames_per_second; `first`
// seconds are skipped, at most `frames` are made. Throws Error naming `name` when hips, legs or
// arms are not found.
BodyMotion retarget_bvh(const Rig& rig, const RigShape& shape, const Bvh& bvh,
                        const std::string& name, int frames, double frames_per_second,
                        double first = 0);
BodyMotion retarget_bvh(const BuiltinBody& body, const Bvh& bvh, const std::string& name,
                        int frames, double frames_per_second, double first = 0);

// A motion for any rig: every joint but the first sways slowly by up to `reach` radians about each
// axis. Helper joints and shapes are not driven.
std::vector<RigPose> swaying_motion(const Rig& rig, int frames, double frames_per_second,
                                    double reach, uint64_t seed);

// A joint by its humanoid name in the rig and in the file; for limbs the next joint of both, whose
// direction it takes, else -1.
struct BvhMatch {
  std::string name;
  int joint = -1, source = -1, child = -1, source_child = -1;
};
std::vector<BvhMatch> match_bvh(const Rig& rig, const Bvh& bvh);

}  // namespace effigy
