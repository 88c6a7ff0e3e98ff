// Motions of the built-in body: exercises made by code, and the user's own BVH files.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "effigy/people/builtin_body.h"
#include "effigy/rig/bvh.h"

namespace effigy {

struct BodyMotion {
  double frames_per_second = 30;
  std::vector<RigPose> poses;  // drive_body_helpers() done
};

// Every joint through its comfortable range at its own slow pace, hands and face included; smooth
// in time, a foot on the floor, deterministic by seed.
BodyMotion range_of_motion(const BuiltinBody& body, int frames, double frames_per_second,
                           uint64_t seed);
// What training has not seen: walking on the spot, waving, turning.
BodyMotion unseen_motion(const BuiltinBody& body, int frames, double frames_per_second,
                         uint64_t seed);

// Moves the body as the file's skeleton moves: bones point where the file's bones point. Joints are
// found by their usual names (CMU, Mixamo, VRM, MakeHuman); those without a counterpart rest.
// Resampled to frames_per_second; `first` seconds are skipped, at most `frames` are made. Throws
// Error naming `name` when hips, legs or arms are not found.
BodyMotion retarget_bvh(const BuiltinBody& body, const Bvh& bvh, const std::string& name,
                        int frames, double frames_per_second, double first = 0);

// A motion for any rig: every joint but the first sways slowly by up to `reach` radians about each
// axis. Helper joints and shapes are not driven.
std::vector<RigPose> swaying_motion(const Rig& rig, int frames, double frames_per_second,
                                    double reach, uint64_t seed);

// (joint of the body, joint of the file, child in the file whose direction it takes or -1).
struct BvhMatch {
  int joint, source, source_child, child;
};
std::vector<BvhMatch> match_bvh(const Rig& rig, const Bvh& bvh);

}  // namespace effigy
