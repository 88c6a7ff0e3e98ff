// Eyes, nose and mouth of the head's outer form (head_shape.h): each takes the signed distance so
// far and returns it with the feature. Points have x >= 0; millimetres.
#pragma once

#include "effigy/geometry/types.h"

namespace effigy::people {

double add_eye_sockets(const Vec3d& p, double distance);
double add_nose(const Vec3d& p, double distance);
double add_mouth(const Vec3d& p, double distance);

// Front view of the lips at x: the border of the upper lip (Cupid's bow), the line between the
// lips, the border of the lower lip.
double lip_top(double x);
double lip_line(double x);
double lip_bottom(double x);

}  // namespace effigy::people
