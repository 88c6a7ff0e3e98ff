// PLY files: what is written is read again, files of other programs too, and damaged ones get one
// sentence.
#include "effigy/geometry/ply.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <functional>

#include "effigy/base/error.h"
#include "effigy/base/random.h"
#include "support.h"

namespace effigy {
namespace {

class Ply : public testing::Test {
 protected:
  PlyVertices read(const std::string& text) {
    write_text(file, text);
    return read_ply_vertices(file);
  }
  void expect_refused(const std::string& about, const std::string& text) {
    std::string sentence;
    try {
      read(text);
    } catch (const Error& error) {
      sentence = error.what();
    }
    EXPECT_NE(sentence.find(about), std::string::npos)
        << "expected '" << about << "' in: " << sentence;
    EXPECT_NE(sentence.find("a.ply"), std::string::npos) << sentence;
  }
  const test::ScratchFolder folder;
  const Path file = folder / "a.ply";
};

const char kAscii[] =
    "ply\r\nformat ascii 1.0\ncomment made by hand\nelement camera 1\nproperty list uchar int "
    "ids\nelement vertex 2\nproperty float x\nproperty uchar red\nproperty double y\nelement face "
    "1\nproperty list uint8 int vertex_indices\nend_header\n2 7 8\n1.5 255 -2e-3\n+3 0 "
    "inf\n3 0 1 2\n";

TEST_F(Ply, WhatIsWrittenIsRead) {
  PlyVertices out;
  out.columns = {"x", "quality"};
  out.values = {1.0f, -2.5f, std::nanf(""), INFINITY, 3.0f, 0.0f};
  out.comments = {"SplatRenderMode: mip"};
  write_ply_vertices(file, out);
  const PlyVertices in = read_ply_vertices(file);
  EXPECT_EQ(in.columns, out.columns);
  EXPECT_EQ(in.comments, out.comments);
  ASSERT_EQ(in.values.size(), out.values.size());
  EXPECT_EQ(std::memcmp(in.values.data(), out.values.data(), 24), 0);
  EXPECT_EQ(in.find("quality"), 1);
  EXPECT_EQ(in.find("z"), -1);
}

TEST_F(Ply, AsciiWithListsAroundTheVertices) {
  const PlyVertices in = read(kAscii);
  EXPECT_EQ(in.columns, (std::vector<std::string>{"x", "red", "y"}));
  EXPECT_EQ(in.comments, (std::vector<std::string>{"made by hand"}));
  ASSERT_EQ(in.count(), 2u);
  EXPECT_EQ(in.values[0], 1.5f);
  EXPECT_EQ(in.values[1], 255.0f);
  EXPECT_EQ(in.values[2], -2e-3f);
  EXPECT_EQ(in.values[3], 3.0f);
  EXPECT_TRUE(std::isinf(in.values[5]));
}

TEST_F(Ply, BinaryOfEveryType) {
  std::string text =
      "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty char a\nproperty uchar "
      "b\nproperty short c\nproperty ushort d\nproperty int e\nproperty uint f\nproperty float "
      "g\nproperty double h\nend_header\n";
  const auto add = [&](auto value) {
    text.append(reinterpret_cast<const char*>(&value), sizeof(value));
  };
  add(int8_t{-3});
  add(uint8_t{200});
  add(int16_t{-300});
  add(uint16_t{60000});
  add(int32_t{-70000});
  add(uint32_t{3000000000u});
  add(1.25f);
  add(-2.5);
  const PlyVertices in = read(text);
  EXPECT_EQ(in.values, (std::vector<float>{-3, 200, -300, 60000, -70000, 3e9f, 1.25f, -2.5f}));
}

TEST_F(Ply, DamagedFilesAreRefused) {
  expect_refused("not a PLY", "");
  expect_refused("not a PLY", "plyx\n");
  expect_refused("header", "ply\nformat ascii 1.0\n");
  expect_refused("format", "ply\nformat binary_big_endian 1.0\nend_header\n");
  expect_refused("no format", "ply\nelement vertex 1\nproperty float x\nend_header\n1\n");
  const std::string head = "ply\nformat ascii 1.0\n";
  expect_refused("vertex", head + "end_header\n");
  expect_refused("not a number", head + "element vertex one\nend_header\n");
  expect_refused("not a number", head + "element vertex -1\nend_header\n");
  expect_refused("before the first", head + "property float x\nend_header\n");
  expect_refused("type", head + "element vertex 1\nproperty half x\nend_header\n1\n");
  expect_refused("twice",
                 head + "element vertex 1\nproperty float x\nproperty float x\nend_header\n1 1\n");
  expect_refused("list", head + "element vertex 1\nproperty list uchar int x\nend_header\n1 1\n");
  expect_refused("understood", head + "elephant vertex 1\nend_header\n");
  const std::string one = "element vertex 1\nproperty float x\nend_header\n";
  expect_refused("ends before", head + one);
  expect_refused("number belongs", head + one + "x\n");
  expect_refused("longer", head + one + "1 2\n");
  expect_refused("ends before",
                 head + "element vertex 99999999999999\nproperty float x\nend_header\n1\n");
  const std::string binary = "ply\nformat binary_little_endian 1.0\n";
  expect_refused("ends before", binary + one + "abc");
  expect_refused("longer", binary + one + "abcde");
  expect_refused("impossible", binary + one.substr(0, one.find("end_header")) +
                                   "element face 1\nproperty list uint int v\nend_header\n" +
                                   std::string("\0\0\0\0\xff\xff\xff\xff", 8));
  EXPECT_THROW(read_ply_vertices(folder / "none.ply"), Error);
}

// Changed bytes never do more than give an error or other numbers.
TEST_F(Ply, AnyChangedByteIsSurvived) {
  Random random(5);
  for (int k = 0; k < 300; ++k) {
    std::string text = kAscii;
    for (int n = 0; n < 3; ++n)
      text[static_cast<size_t>(random.below(text.size()))] = static_cast<char>(random.below(256));
    try {
      read(text);
    } catch (const Error&) {
    }
  }
}

}  // namespace
}  // namespace effigy
