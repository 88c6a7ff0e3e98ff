// NumPy files: every type and order, and damaged files.
#include "effigy/base/npy.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <cstring>

#include "effigy/base/error.h"
#include "write_zip.h"

namespace effigy {
namespace {

using Bytes = std::vector<uint8_t>;

template <typename T>
Bytes raw(std::initializer_list<T> values) {
  Bytes bytes(values.size() * sizeof(T));
  std::memcpy(bytes.data(), std::data(values), bytes.size());
  return bytes;
}

Bytes npy(const std::string& header, const Bytes& data, int version = 1) {
  Bytes bytes = {0x93, 'N', 'U', 'M', 'P', 'Y', static_cast<uint8_t>(version), 0};
  for (int i = 0; i < (version == 1 ? 2 : 4); ++i)
    bytes.push_back(static_cast<uint8_t>(header.size() >> (8 * i)));
  bytes.insert(bytes.end(), header.begin(), header.end());
  bytes.insert(bytes.end(), data.begin(), data.end());
  return bytes;
}

std::string head(const std::string& descr, const std::string& shape, bool fortran = false) {
  return "{'descr': '" + descr + "', 'fortran_order': " + (fortran ? "True" : "False") +
         ", 'shape': " + shape + ", }     \n";
}

TEST(Npy, AllNumberTypes) {
  EXPECT_EQ(parse_npy(npy(head("<f4", "(2,)"), raw<float>({1.5f, -2})), "a").floats(),
            (std::vector<float>{1.5f, -2}));
  EXPECT_EQ(parse_npy(npy(head("<f8", "(1, 2)"), raw<double>({0.1, 7})), "a").doubles(),
            (std::vector<double>{0.1, 7}));
  EXPECT_EQ(parse_npy(npy(head("<i2", "(2L,)"), raw<int16_t>({-3, 300})), "a").integers(),
            (std::vector<int64_t>{-3, 300}));
  EXPECT_EQ(parse_npy(npy(head("|i1", "(2,)"), raw<int8_t>({-3, 3})), "a").integers(),
            (std::vector<int64_t>{-3, 3}));
  EXPECT_EQ(parse_npy(npy(head("|u1", "(2,)"), raw<uint8_t>({3, 255})), "a").integers(),
            (std::vector<int64_t>{3, 255}));
  EXPECT_EQ(parse_npy(npy(head("<u4", "(1,)"), raw<uint32_t>({4294967295u})), "a").integers(),
            (std::vector<int64_t>{4294967295}));
  EXPECT_EQ(parse_npy(npy(head("<i8", "()"), raw<int64_t>({-5}), 2), "a").integers(),
            (std::vector<int64_t>{-5}));
  EXPECT_EQ(parse_npy(npy(head("|b1", "(2,)"), Bytes{0, 1}, 3), "a").integers(),
            (std::vector<int64_t>{0, 1}));
  // Half precision: 1, -2, the smallest number, the largest, infinity.
  const auto half =
      parse_npy(npy(head("<f2", "(5,)"), raw<uint16_t>({0x3C00, 0xC000, 1, 0x7BFF, 0x7C00})), "a")
          .doubles();
  EXPECT_EQ(half[0], 1);
  EXPECT_EQ(half[1], -2);
  EXPECT_EQ(half[2], std::ldexp(1, -24));
  EXPECT_EQ(half[3], 65504);
  EXPECT_TRUE(std::isinf(half[4]));
}

TEST(Npy, BigEndianAndFortranOrder) {
  EXPECT_EQ(
      parse_npy(npy(head(">i4", "(2,)"), Bytes{0, 0, 1, 2, 255, 255, 255, 254}), "a").integers(),
      (std::vector<int64_t>{258, -2}));
  // A 2 x 3 array and a 2 x 2 x 3 one, stored with the first index fastest.
  EXPECT_EQ(parse_npy(npy(head("<i2", "(2, 3)", true), raw<int16_t>({0, 10, 1, 11, 2, 12})), "a")
                .integers(),
            (std::vector<int64_t>{0, 1, 2, 10, 11, 12}));
  EXPECT_EQ(parse_npy(npy(head("|u1", "(2, 2, 3)", true),
                          Bytes{0, 100, 10, 110, 1, 101, 11, 111, 2, 102, 12, 112}),
                      "a")
                .integers(),
            (std::vector<int64_t>{0, 1, 2, 10, 11, 12, 100, 101, 102, 110, 111, 112}));
}

TEST(Npy, Texts) {
  const Bytes padded = {'a', 'b', 0, 'c', 0, 0};
  EXPECT_EQ(parse_npy(npy(head("|S3", "(2,)"), padded), "a").strings(),
            (std::vector<std::string>{"ab", "c"}));
  EXPECT_EQ(
      parse_npy(npy(head("<U2", "(2,)"), raw<uint32_t>({'x', 0, 0xE9, 0x1F600})), "a").strings(),
      (std::vector<std::string>{"x", "\xC3\xA9\xF0\x9F\x98\x80"}));
}

TEST(Npy, WrongConversionsAreErrors) {
  const NpyArray floats = parse_npy(npy(head("<f4", "(1,)"), raw<float>({1})), "a");
  EXPECT_THROW(floats.integers(), Error);
  EXPECT_THROW(floats.strings(), Error);
  EXPECT_THROW(parse_npy(npy(head("|S1", "(1,)"), Bytes{'x'}), "a").floats(), Error);
  EXPECT_THROW(parse_npy(npy(head("<u8", "(1,)"), raw<uint64_t>({~0ull})), "a").integers(), Error);
}

TEST(Npy, HostileFilesAreRefused) {
  const Bytes data = raw<float>({1, 2});
  const Bytes good = npy(head("<f4", "(2,)"), data);
  for (size_t length = 0; length < good.size(); ++length)
    EXPECT_THROW(parse_npy(std::span(good).first(length), "a"), Error) << length;
  for (const std::string& header :
       {head("|O", "(2,)"),
        head("<f16", "(2,)"),
        head("<c8", "(1,)"),
        head("|S0", "(4000000000,)"),
        head("", "(2,)"),
        head("<", "(2,)"),
        head("<f4x", "(2,)"),
        head("<f4444444444444", "(2,)"),
        head("<f4", "(3,)"),
        head("<f4", "(-2,)"),
        head("<f4", "(4294967296, 4294967296)"),
        head("<f4", "(99999999999999999999,)"),
        head("<f4", "(0, 4294967296, 4294967296)"),
        head("<f4", "2"),
        head("<f4", "(2"),
        std::string("{'descr': '<f4'}"),
        std::string("{"),
        std::string("[('a', '<f4')]"),
        std::string("{'descr': [('a', '<f4')], }"),
        std::string("{'descr': '<f4', 'fortran_order': Maybe, 'shape': (2,)}"),
        head("<f4", "(2,)") + "x",
        std::string("{'x': '<f4'}")})
    EXPECT_THROW(parse_npy(npy(header, data), "a"), Error) << header;
  EXPECT_THROW(parse_npy(npy(head("<f4", "(2,)"), data, 9), "a"), Error);
  try {
    parse_npy(npy(head("|O", "(2,)"), data), "face.npy");
    FAIL();
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("face.npy"), std::string::npos);
    EXPECT_NE(std::string(error.what()).find("Python objects"), std::string::npos);
  }
}

TEST(Npz, ReadsArraysAndPassesObjectsOver) {
  const Path path = Path(::testing::TempDir()) / "arrays.npz";
  test::write_zip(path, {{"a.npy", npy(head("<f4", "(2,)"), raw<float>({1, 2}))},
                         {"b.npy", npy(head("<i8", "(1,)"), raw<int64_t>({9}))},
                         {"objects.npy", npy(head("|O", "(1,)"), Bytes{0x80, 2, 'N', '.'})},
                         {"notes.txt", Bytes{'h', 'i'}}});
  const auto arrays = read_npz(path);
  ASSERT_EQ(arrays.size(), 2u);
  EXPECT_EQ(arrays.at("a").floats(), (std::vector<float>{1, 2}));
  EXPECT_EQ(arrays.at("b").integers(), (std::vector<int64_t>{9}));
}

TEST(Npz, DamagedArchivesAreRefused) {
  const Path path = Path(::testing::TempDir()) / "damaged.npz";
  test::write_zip(path, {{"a.npy", npy(head("<f4", "(300,)"), Bytes(1200, 7))}});
  Bytes bytes = read_file(path);
  for (const size_t length : {size_t{0}, size_t{10}, bytes.size() / 2, bytes.size() - 1}) {
    write_file(path, std::span(bytes).first(length));
    EXPECT_THROW(read_npz(path), Error) << length;
  }
  for (size_t i = 40; i < 60; ++i) bytes[i] ^= 0x5A;  // the compressed data
  write_file(path, bytes);
  EXPECT_THROW(read_npz(path), Error);
  EXPECT_THROW(read_npz("/nowhere/x.npz"), Error);
}

TEST(Npz, PublishedFiles) {
  const char* data = std::getenv("EFFIGY_DATA");
  if (data == nullptr) GTEST_SKIP() << "EFFIGY_DATA is not set";
  const Path folder = Path(data) / "face/flame_topology";
  const auto landmarks = read_npz(folder / "mediapipe_landmark_embedding.npz");
  ASSERT_EQ(landmarks.at("lmk_face_idx").shape, (std::vector<int64_t>{105}));
  // Stored in Fortran order: only correct reading makes rows sum to 1.
  const std::vector<double> weights = landmarks.at("lmk_b_coords").doubles();
  ASSERT_EQ(weights.size(), 315u);
  for (size_t i = 0; i < 105; ++i)
    EXPECT_NEAR(weights[3 * i] + weights[3 * i + 1] + weights[3 * i + 2], 1, 1e-6);
  EXPECT_EQ(read_npy(folder / "l_eyelid.npy").shape, (std::vector<int64_t>{5023, 3}));
  const auto fit = read_npz(Path(data) / "tracked/cap4d/felix/fit.npz");
  EXPECT_EQ(fit.at("camera_order").strings().size(), 1u);
}

}  // namespace
}  // namespace effigy
