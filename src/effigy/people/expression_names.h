// Which of the program's expressions a morph target of anybody's head is.
#pragma once

#include <string>

namespace effigy {

// The built-in head's name of the expression, "mouthSmile_L": ARKit's names, whatever the case, the
// separators, the spelling of the side (Left, left, L, _l, .R) and what stands before them
// ("blendShape1.jawOpen", "Face_MouthSmileLeft"), and a few usual names besides ("mouthOpen",
// "Blink_L", MakeHuman's). Of the pairs, a target for both sides keeps its name without side
// ("eyeBlink"). Empty when the name is not known.
std::string known_expression(const std::string& name);

}  // namespace effigy
