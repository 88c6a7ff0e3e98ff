// TFLite flatbuffers, read without a schema compiler: the subset that MediaPipe's published
// networks use (one subgraph, batch 1, float tensors, half-precision constants).
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace effigy {

// What an operator does; the numbers are TFLite's builtin codes.
enum class TfliteOp : int {
  kAdd = 0,
  kAveragePool = 1,
  kConcat = 2,
  kConv = 3,
  kDepthwiseConv = 4,
  kDequantize = 6,  // folded by the parser
  kLogistic = 14,
  kMaxPool = 17,
  kMul = 18,
  kRelu = 19,
  kRelu6 = 21,
  kReshape = 22,
  kResizeBilinear = 23,
  kCustom = 32,
  kPad = 34,
  kTranspose = 39,
  kMean = 40,
  kSub = 41,
  kDiv = 42,
  kStridedSlice = 45,
  kPrelu = 54,
  kNeg = 59,
  kSum = 74,
  kSqrt = 75,
  kRsqrt = 76,
  kSquaredDifference = 99,
  kHardSwish = 117,
};

enum class TfliteActivation { kNone = 0, kRelu = 1, kRelu6 = 3 };

struct TfliteTensor {
  std::string name;
  std::vector<int64_t> shape;  // NHWC for images; every entry >= 1
  bool integer = false;        // int32, else float
  bool constant = false;
  std::vector<float> floats;  // constants (half precision already widened)
  std::vector<int32_t> ints;
  int64_t count() const;
};

struct TfliteNode {
  TfliteOp op = TfliteOp::kAdd;
  std::string custom;       // name when op == kCustom
  std::vector<int> inputs;  // tensor indices; -1 = left out
  std::vector<int> outputs;
  // Options; which of them mean something depends on op.
  bool same_padding = false;
  int stride_w = 1, stride_h = 1, dilation_w = 1, dilation_h = 1;
  int filter_w = 1, filter_h = 1;  // pools
  TfliteActivation activation = TfliteActivation::kNone;
  int axis = 0;  // concat
  bool align_corners = false, half_pixel_centers = false;
  bool keep_dims = false;
  int begin_mask = 0, end_mask = 0, ellipsis_mask = 0, new_axis_mask = 0, shrink_mask = 0;
  std::vector<uint8_t> custom_bytes;
};

struct TfliteModel {
  std::vector<TfliteTensor> tensors;
  std::vector<TfliteNode> nodes;  // in execution order
  std::vector<int> inputs, outputs;
};

// Parses and checks: every offset lies in the file, every tensor index exists, every node reads
// only constants, inputs and earlier results, constants have exactly the bytes of their shape, no
// tensor exceeds 2^24 elements. Throws Error (prefixed by `name`) otherwise, and for operators or
// data types outside the subset.
TfliteModel parse_tflite(std::span<const uint8_t> bytes, const std::string& name);

// IEEE 754 binary16 to binary32, exact.
float float_from_half(uint16_t half);

}  // namespace effigy
