// Where the lights of a stage stand, from a file: a user's own plan, or positions measured in a
// real stage, whose axes and centre need not be ours.
#pragma once

#include <string>
#include <vector>

#include "effigy/base/file.h"
#include "effigy/geometry/types.h"

namespace effigy {

enum class UpAxis { kAuto, kPlusX, kMinusX, kPlusY, kMinusY, kPlusZ, kMinusZ };
UpAxis up_axis_from_name(const std::string& name);  // "auto", "+y", "-z" ...; throws Error

// Positions from .npy ([N, 3]) or text (three numbers a line, # comments) as directions and
// relative distances from the dome's centre, brought to a mean distance of `radius` from `centre`.
// Their own centre is the origin, or, when ten or more of them lie on a sphere to a thousandth of
// its radius, the sphere's centre. `up` names the file's axis that points up; kAuto: +y, unless
// lights surround the centre but for one opening, at +y: stages are open at the floor, so y points
// down there. Files with x or z up are turned about the next axis in order (z up: about x), y down
// about x. Throws Error naming the file.
std::vector<Vec3d> read_light_positions(const Path& path, double radius, const Vec3d& centre,
                                        UpAxis up = UpAxis::kAuto);

// Half the angle of the largest round opening without lights whose middle is within 30 degrees of
// `towards`, radians; directions are unit.
double opening_towards(const std::vector<Vec3d>& directions, const Vec3d& towards);

}  // namespace effigy
