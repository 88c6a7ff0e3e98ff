// The colour of skin from its pigments: a thin epidermis with melanin over a deep dermis with
// blood.
#pragma once

#include "effigy/geometry/types.h"

namespace effigy {

// Diffuse albedo, linear sRGB in [0, 1], of skin whose epidermis is melanin by the volume fraction
// `melanin` (0.003 very fair .. 0.4 very dark) and whose dermis is blood by `blood` (0.001 .. 0.1);
// both are clamped to these ranges. From a table, about 2 % exact, safe from many threads.
//
// Absorption of melanin and of bloodless tissue: Jacques 1998; haemoglobin: Prahl's tabulation;
// diffuse reflectance of the dermis: Flock et al. 1989 in the two-layer form of Donner and Jensen
// 2006, with the single scattering of the epidermis added; colour matching: Wyman, Sloan and
// Shirley 2013 under D65.
Vec3d skin_albedo(double melanin, double blood);

// Reflectance at a wavelength in nanometres, 400 .. 700.
double skin_reflectance(double wavelength, double melanin, double blood);

}  // namespace effigy
