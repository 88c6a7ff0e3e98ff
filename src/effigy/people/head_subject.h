// Who a built-in head is: what differs from person to person beside the common mesh.
#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "effigy/geometry/types.h"

namespace effigy::people {

// Short hair as a shell over the scalp, millimetres.
struct HairStyle {
  double top = 9, sides = 4, nape = 2.5;  // thickness
  double recede = 0;                      // how far the hairline stands back at the temples
  double lift = 0;                        // how far the whole hairline is raised
  double clumps = 1.2, clump_size = 14;   // relief
  double sideburn = 1;                    // 0: none
  double curl = 0;                        // 0 straight .. 1 curly
  double comb = 0;                        // 0 from the whorl .. 1 straight back
};

struct Subject {
  std::vector<std::pair<std::string, double>> identity;  // by mode, standard deviations
  HairStyle hair;
  Vec3d hair_colour = Vec3d(0.060, 0.036, 0.022);  // linear
  double grey = 0;                                 // share of white hairs
  Vec3d brow_colour = Vec3d(0.075, 0.045, 0.030);
  double brow_width = 1;
  double melanin = 0.015, blood = 0.009;  // volume fractions (skin_optics.h)
  double freckles = 0.3;                  // 0 .. 1
  double stubble = 0.6;                   // 0 none, 1 two days, 2 a short beard
  double oil = 1;                         // shine of the middle of the face
  double age = 0.3;                       // 0 .. 1: lines, blotches, tired eyes
  double lip_blood = 1;                   // redness of the lips
  Vec3d iris_inner = Vec3d(0.19, 0.115, 0.045), iris_outer = Vec3d(0.10, 0.13, 0.115);
  Vec3d pattern = Vec3d::Zero();  // moves spots and blotches about
};

// 1 to 5 are the standard subjects, 1 of average shape; every other number is somebody at random.
Subject make_subject(uint64_t subject);

// 1 where hair grows, 0 on bare skin, changing over `soft` millimetres at the hairline; p in
// millimetres on the mean head.
double hair_cover(const Vec3d& p, double soft, const HairStyle& style);
// Thickness of the shell at p.
double hair_thickness(const Vec3d& p, const HairStyle& style);

}  // namespace effigy::people
