#include "effigy/base/safetensors.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>

#include "base/temp_folder.h"
#include "effigy/base/error.h"
#include "effigy/base/random.h"

namespace effigy {
namespace {

using test::TempFolder;

// A file of any header and data, well-formed or not.
std::vector<uint8_t> raw(uint64_t header_size, const std::string& header, size_t data_bytes) {
  std::vector<uint8_t> bytes(8 + header.size() + data_bytes);
  std::memcpy(bytes.data(), &header_size, 8);
  std::memcpy(bytes.data() + 8, header.data(), header.size());
  return bytes;
}
std::vector<uint8_t> raw(const std::string& header, size_t data_bytes) {
  return raw(header.size(), header, data_bytes);
}

TensorFile sample() {
  TensorFile file;
  const std::vector<float> floats = {1.5f, -2, 3, 4, 5, 6};
  const std::vector<int32_t> ints = {-1, 2};
  const std::vector<int64_t> longs = {int64_t{1} << 40};
  const std::vector<uint8_t> bytes = {9, 8, 7};
  file.tensors["floats"] = Tensor::from(std::span(floats), {2, 3});
  file.tensors["ints"] = Tensor::from(std::span(ints), {2});
  file.tensors["longs"] = Tensor::from(std::span(longs), {1, 1, 1});
  file.tensors["bytes"] = Tensor::from(std::span(bytes), {3});
  file.tensors["empty"] = Tensor::from(std::span<const float>(), {0, 3});
  file.metadata["format"] = "effigy";
  return file;
}

TEST(Safetensors, RoundTrip) {
  const TempFolder folder;
  write_safetensors(folder / "a.safetensors", sample());
  const TensorFile file = read_safetensors(folder / "a.safetensors");
  EXPECT_EQ(file.metadata.at("format"), "effigy");
  EXPECT_EQ(file.floats("floats", {2, 3}), (std::vector<float>{1.5f, -2, 3, 4, 5, 6}));
  EXPECT_EQ(file.floats("floats", {-1, 3}).size(), 6u);
  EXPECT_EQ(file.ints("ints", {2}), (std::vector<int32_t>{-1, 2}));
  EXPECT_EQ(file.longs("longs", {1, -1, 1}).at(0), int64_t{1} << 40);
  EXPECT_EQ(file.bytes("bytes", {3}), (std::vector<uint8_t>{9, 8, 7}));
  EXPECT_TRUE(file.floats("empty", {0, 3}).empty());
  EXPECT_EQ(file.shape("floats"), (std::vector<int64_t>{2, 3}));
  EXPECT_TRUE(file.has("ints"));
  EXPECT_FALSE(file.has("other"));
  // Header padded so that data is aligned.
  uint64_t header_size = 0;
  const auto bytes = read_file(folder / "a.safetensors");
  std::memcpy(&header_size, bytes.data(), 8);
  EXPECT_EQ(header_size % 8, 0u);
}

template <typename Function>
void expect_error(Function&& function, const std::string& part) {
  try {
    function();
    ADD_FAILURE() << "no Error, expected: " << part;
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << error.what();
    EXPECT_NE(std::string(error.what()).find("a.safetensors"), std::string::npos) << error.what();
  }
}

TEST(Safetensors, AccessErrorsNameFileAndTensor) {
  const TempFolder folder;
  TensorFile made = sample();
  const std::vector<float> bad = {1, std::nanf(""), 3};
  made.tensors["bad"] = Tensor::from(std::span(bad), {3});
  write_safetensors(folder / "a.safetensors", made);
  const TensorFile file = read_safetensors(folder / "a.safetensors");
  expect_error([&] { file.floats("other", {1}); }, "'other' is missing");
  expect_error([&] { file.shape("other"); }, "'other' is missing");
  expect_error([&] { file.floats("ints", {2}); }, "'ints' is I32");
  expect_error([&] { file.floats("floats", {3, 2}); }, "(2, 3)");
  expect_error([&] { file.floats("floats", {6}); }, "'floats'");
  expect_error([&] { file.floats("floats", {2, 3, 1}); }, "'floats'");
  expect_error([&] { file.floats("bad", {3}); }, "not finite (element 1)");
}

TEST(Safetensors, HostileFiles) {
  const TempFolder folder;
  const Path path = folder / "a.safetensors";
  const auto rejects = [&](const std::vector<uint8_t>& bytes, const std::string& what) {
    write_file(path, bytes);
    try {
      read_safetensors(path);
      ADD_FAILURE() << "accepted: " << what;
    } catch (const Error& error) {
      EXPECT_NE(std::string(error.what()).find(path.string()), std::string::npos) << what;
      EXPECT_EQ(error.exit_code(), 2) << what;
    }
  };
  const auto tensor = [](const std::string& dtype, const std::string& shape,
                         const std::string& offsets) {
    return "{\"t\":{\"dtype\":" + dtype + ",\"shape\":" + shape + ",\"data_offsets\":" + offsets +
           "}}";
  };
  rejects({}, "empty file");
  rejects({1, 2, 3}, "shorter than the header length");
  rejects(raw(~uint64_t{0}, "{}", 0), "header of 2^64 bytes");
  rejects(raw(uint64_t{1} << 62, "{}", 0), "header longer than the file");
  rejects(raw(3, "{}", 0), "header one byte too long");
  rejects(raw("", 0), "no header");
  rejects(raw("[1,2", 0), "cut JSON");
  rejects(raw("{\"t\":5}", 0), "entry is a number");
  rejects(raw("{\"t\":{}}", 0), "entry without fields");
  rejects(raw(tensor("5", "[1]", "[0,4]"), 4), "dtype is a number");
  rejects(raw(tensor("\"F31\"", "[1]", "[0,4]"), 4), "unknown dtype");
  rejects(raw(tensor("\"F32\"", "\"1\"", "[0,4]"), 4), "shape is text");
  rejects(raw(tensor("\"F32\"", "[-1]", "[0,4]"), 4), "negative length");
  rejects(raw(tensor("\"F32\"", "[2]", "[0,4]"), 8), "range too short");
  rejects(raw(tensor("\"F32\"", "[1]", "[0,8]"), 8), "range too long");
  rejects(raw(tensor("\"F32\"", "[1]", "[4,8]"), 4), "range behind the data");
  rejects(raw(tensor("\"F32\"", "[1]", "[4,0]"), 4), "range turned round");
  rejects(raw(tensor("\"F32\"", "[1]", "[-4,0]"), 4), "negative range");
  rejects(raw(tensor("\"F32\"", "[1]", "[0]"), 4), "range with one end");
  rejects(raw(tensor("\"F32\"", "[1]", "[0,4,8]"), 8), "range with three ends");
  rejects(raw(tensor("\"F32\"", "[4294967296,4294967296]", "[0,0]"), 0), "count overflows");
  rejects(raw(tensor("\"F32\"", "[2147483648,2147483648,4]", "[0,0]"), 0), "count overflows to 0");
  rejects(raw(tensor("\"F32\"", "[1]", "[18446744073709551612,18446744073709551616]"), 4),
          "ends overflow");
  rejects(raw("{\"__metadata__\":{\"a\":1}}", 0), "metadata is no text");
  rejects(raw(std::string(100000, '['), 0), "deep nesting");
}

TEST(Safetensors, DamagedCopiesNeverCrash) {
  const TempFolder folder;
  write_safetensors(folder / "good.safetensors", sample());
  const auto good = read_file(folder / "good.safetensors");
  Random random(5);
  int accepted = 0;
  for (int i = 0; i < 600; ++i) {
    auto bytes = good;
    if (i % 3 == 0) {
      bytes.resize(random.below(good.size()));
    } else {
      for (uint64_t k = 0; k <= random.below(6); ++k)
        bytes[random.below(bytes.size())] = static_cast<uint8_t>(random.below(256));
    }
    write_file(folder / "a.safetensors", bytes);
    try {
      const TensorFile file = read_safetensors(folder / "a.safetensors");
      for (const auto& [name, tensor] : file.tensors)
        EXPECT_LE(tensor.bytes.size(), bytes.size()) << name;
      ++accepted;
    } catch (const Error& error) {
      EXPECT_NE(std::string(error.what()).find("a.safetensors"), std::string::npos);
    }
  }
  EXPECT_LT(accepted, 400);  // changed values are fine, changed structure is not
}

TEST(Safetensors, SizesThatDoNotMatchAreDefects) {
  const std::vector<float> values(5);
  EXPECT_THROW(Tensor::from(std::span(values), {2, 3}), Error);
}

}  // namespace
}  // namespace effigy
