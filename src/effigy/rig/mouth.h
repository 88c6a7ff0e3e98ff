// Teeth and a mouth interior for head rigs that have neither (FLAME's lips end in an open rim).
#pragma once

#include "effigy/rig/rig.h"

namespace effigy {

// Adds the parts "teeth" (two strips along the jaws: front, edge and back) and "mouth" (a bag that
// begins at the rim of the lips, welded to it, and closes behind the teeth).
//
// Every new vertex is a fixed linear combination of vertices of the rim plus a fixed offset, so it
// follows the identity shapes. Teeth are rigid: upper ones move with joint "neck", lower ones with
// "jaw", and no expression moves them. The bag takes over the lips' expressions at the rim and lets
// go of them within a third of its depth; its lower half follows the jaw less and less.
//
// Real UV islands, apart from each other and from everything else, in the free band
// u 0.15 .. 0.85, v 0.957 .. 0.993 of FLAME's layout.
//
// The rig must have joints "neck" and "jaw", UVs, parts, and exactly one open rim in part "skin"
// besides rig.neck_ring. Throws Error, beginning with `name`, when it is otherwise or when the UV
// band is not free.
void add_mouth(Rig& rig, const std::string& name);

}  // namespace effigy
