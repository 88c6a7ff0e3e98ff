// Point numbers and score names of MediaPipe's face networks.
#pragma once

#include <array>
#include <string_view>

namespace effigy::mediapipe {

// Of the 68 MultiPIE/iBUG landmarks (rig/embedding.h tells which points they are), the first of the
// inner ones: before it stands the contour.
inline constexpr int kFirstInner = 17;

// The outline of the face: slides over the skin when the head turns.
inline constexpr std::array<int, 36> kOval = {
    10,  338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377,
    152, 148, 176, 149, 150, 136, 172, 58,  132, 93,  234, 127, 162, 21,  54,  103, 67,  109};

inline constexpr std::array<int, 40> kLips = {
    61, 146, 91, 181, 84, 17, 314, 405, 321, 375, 291, 185, 40, 39, 37, 0,  267, 269, 270, 409,
    78, 95,  88, 178, 87, 14, 317, 402, 318, 324, 308, 191, 80, 81, 82, 13, 312, 311, 310, 415};

// Lid contours; "right" is the person's right, at the left of an unmirrored picture.
inline constexpr std::array<int, 16> kEyeRight = {33,  7,   163, 144, 145, 153, 154, 155,
                                                  133, 173, 157, 158, 159, 160, 161, 246};
inline constexpr std::array<int, 16> kEyeLeft = {263, 249, 390, 373, 374, 380, 381, 382,
                                                 362, 398, 384, 385, 386, 387, 388, 466};
inline constexpr int kOuterCornerRight = 33, kOuterCornerLeft = 263;
// Upper and lower lid, middle: their distance over the eye's width tells a blink.
inline constexpr std::array<int, 2> kLidsRight = {159, 145}, kLidsLeft = {386, 374};

inline constexpr std::array<int, 20> kBrows = {70,  63,  105, 66,  107, 46,  53,  52,  65,  55,
                                               300, 293, 334, 296, 336, 276, 283, 282, 295, 285};

// Iris: centre, then four points of its rim (only with 478 points).
inline constexpr int kFirstIris = 468;
inline constexpr int kIrisRight = 468, kIrisLeft = 473;

// The points whose picture positions are the input of the blendshape network, in its order.
inline constexpr std::array<int, 146> kBlendshapeInput = {
    0,   1,   4,   5,   6,   7,   8,   10,  13,  14,  17,  21,  33,  37,  39,  40,  46,  52,  53,
    54,  55,  58,  61,  63,  65,  66,  67,  70,  78,  80,  81,  82,  84,  87,  88,  91,  93,  95,
    103, 105, 107, 109, 127, 132, 133, 136, 144, 145, 146, 148, 149, 150, 152, 153, 154, 155, 157,
    158, 159, 160, 161, 162, 163, 168, 172, 173, 176, 178, 181, 185, 191, 195, 197, 234, 246, 249,
    251, 263, 267, 269, 270, 276, 282, 283, 284, 285, 288, 291, 293, 295, 296, 297, 300, 308, 310,
    311, 312, 314, 317, 318, 321, 323, 324, 332, 334, 336, 338, 356, 361, 362, 365, 373, 374, 375,
    377, 378, 379, 380, 381, 382, 384, 385, 386, 387, 388, 389, 390, 397, 398, 400, 402, 405, 409,
    415, 454, 466, 468, 469, 470, 471, 472, 473, 474, 475, 476, 477};

inline constexpr std::array<std::string_view, 52> kBlendshapeNames = {
    "_neutral",         "browDownLeft",      "browDownRight",      "browInnerUp",
    "browOuterUpLeft",  "browOuterUpRight",  "cheekPuff",          "cheekSquintLeft",
    "cheekSquintRight", "eyeBlinkLeft",      "eyeBlinkRight",      "eyeLookDownLeft",
    "eyeLookDownRight", "eyeLookInLeft",     "eyeLookInRight",     "eyeLookOutLeft",
    "eyeLookOutRight",  "eyeLookUpLeft",     "eyeLookUpRight",     "eyeSquintLeft",
    "eyeSquintRight",   "eyeWideLeft",       "eyeWideRight",       "jawForward",
    "jawLeft",          "jawOpen",           "jawRight",           "mouthClose",
    "mouthDimpleLeft",  "mouthDimpleRight",  "mouthFrownLeft",     "mouthFrownRight",
    "mouthFunnel",      "mouthLeft",         "mouthLowerDownLeft", "mouthLowerDownRight",
    "mouthPressLeft",   "mouthPressRight",   "mouthPucker",        "mouthRight",
    "mouthRollLower",   "mouthRollUpper",    "mouthShrugLower",    "mouthShrugUpper",
    "mouthSmileLeft",   "mouthSmileRight",   "mouthStretchLeft",   "mouthStretchRight",
    "mouthUpperUpLeft", "mouthUpperUpRight", "noseSneerLeft",      "noseSneerRight"};

}  // namespace effigy::mediapipe
