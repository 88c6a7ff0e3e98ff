// torch.save files of every age are read, everything hostile is refused.
#include "effigy/base/torch_file.h"

#include <fstream>
#include <limits>

#include "base/torch_writer.h"
#include "support.h"

namespace effigy {
namespace {

using test::contains;
using test::error_of;
using test::TorchEntry;
using test::TorchForm;
using test::TorchState;
using test::TorchWriter;

const TorchState kState = {{"features.0.weight", {2, 3}, {1, -2, 3, 4.5f, 5, 6}},
                           {"features.0.bias", {2}, {-1, 0.25f}}};

// The sentence of the error that reading the whole of `path` must end in.
std::string refusal(const Path& path) {
  return error_of([&] {
    const TorchFile file(path);
    for (const std::string& name : file.names()) file.read(name);
  });
}
std::string refusal_of(const TorchState& state, const TorchForm& form = {}) {
  const test::ScratchFolder scratch;
  test::write_torch(state, scratch / "net.pth", form);
  const std::string sentence = refusal(scratch / "net.pth");
  EXPECT_TRUE(contains(sentence, "net.pth")) << sentence;
  return sentence;
}
// The same for a dictionary whose pickle is `root`, in the zip container with one storage '100'.
std::string refusal_of_pickle(const std::string& root) {
  const test::ScratchFolder scratch;
  TorchWriter::write_entries({{"net/data.pkl", root}, {"net/data/100", std::string(24, '\0')}},
                             scratch / "net.pth");
  const std::string sentence = refusal(scratch / "net.pth");
  EXPECT_TRUE(contains(sentence, "net.pth")) << sentence;
  return sentence;
}

TEST(TorchFile, EveryFormReadsTheSame) {
  const test::ScratchFolder scratch;
  for (const bool zip : {true, false})
    for (const bool python2 : {true, false})
      for (const bool parameters : {true, false})
        for (const bool first_version : {true, false}) {
          TorchForm form;
          form.zip = zip;
          form.python2 = python2;
          form.parameters = parameters;
          form.first_version = first_version;
          test::write_torch(kState, scratch / "net.pth", form);
          const TorchFile file(scratch / "net.pth");
          EXPECT_EQ(file.names(),
                    (std::vector<std::string>{"features.0.bias", "features.0.weight"}));
          EXPECT_TRUE(file.has("features.0.bias"));
          EXPECT_FALSE(file.has("_metadata"));
          EXPECT_EQ(file.shape("features.0.weight"), (std::vector<int64_t>{2, 3}));
          EXPECT_EQ(file.read("features.0.weight"), kState[0].values);
          EXPECT_EQ(file.read("features.0.bias"), kState[1].values);
        }
}

TEST(TorchFile, OtherNumbers) {
  const test::ScratchFolder scratch;
  const auto read = [&](const std::string& type, auto value, bool zip) {
    TorchForm form;
    form.zip = zip;
    form.type = type;
    form.encode = [&](const std::vector<float>& values) {
      std::string bytes;
      for (size_t i = 0; i < values.size(); ++i)
        bytes.append(reinterpret_cast<const char*>(&value), sizeof(value));
      return bytes;
    };
    test::write_torch({{"x", {2}, {0, 0}}}, scratch / "net.pth", form);
    return TorchFile(scratch / "net.pth").read("x");
  };
  for (const bool zip : {true, false}) {
    EXPECT_EQ(read("DoubleStorage", 1.25, zip), (std::vector<float>{1.25f, 1.25f}));
    EXPECT_EQ(read("HalfStorage", uint16_t{0xC100}, zip), (std::vector<float>{-2.5f, -2.5f}));
    EXPECT_EQ(read("HalfStorage", uint16_t{0x0001}, zip)[0], 0x1p-24f);
    EXPECT_EQ(read("BFloat16Storage", uint16_t{0x3FC0}, zip)[1], 1.5f);
    EXPECT_TRUE(contains(error_of([&] { read("LongStorage", int64_t{7}, zip); }), "'x' holds no"));
  }
}

TEST(TorchFile, ViewsOfAStorage) {
  const test::ScratchFolder scratch;
  // The transpose of rows 1 and 2 of a 3 x 2 storage.
  test::write_torch({{"x", {2, 2}, {0, 1, 2, 3, 4, 5}, {1, 2}, 2}}, scratch / "net.pth");
  EXPECT_EQ(TorchFile(scratch / "net.pth").read("x"), (std::vector<float>{2, 4, 3, 5}));
}

TEST(TorchFileHostile, TensorsThatLeaveTheirStorage) {
  const std::vector<float> six = {0, 1, 2, 3, 4, 5};
  for (const bool zip : {true, false}) {
    TorchForm form;
    form.zip = zip;
    EXPECT_TRUE(contains(refusal_of({{"x", {7}, six}}, form), "larger than"));
    EXPECT_TRUE(contains(refusal_of({{"x", {6}, six, {1}, 1}}, form), "outside"));
    EXPECT_TRUE(contains(refusal_of({{"x", {2, 2}, six, {5, 1}}}, form), "outside"));
    EXPECT_TRUE(contains(refusal_of({{"x", {}, six, {}, 6}}, form), "outside"));
    EXPECT_TRUE(contains(refusal_of({{"x", {2}, six, {2'000'000'000}}}, form), "larger than"));
    // Strides of zero repeat a number without end; the count is held to the storage's.
    EXPECT_TRUE(contains(refusal_of({{"x", {1000, 1000}, six, {0, 0}}}, form), "larger than"));
    EXPECT_TRUE(contains(refusal_of({{"x", {-1}, six, {1}}}, form), "a length that is none"));
    EXPECT_TRUE(contains(refusal_of({{"x", {1}, six, {-1}}}, form), "a length that is none"));
    EXPECT_TRUE(contains(refusal_of({{"x", {1}, six, {1}, -4}}, form), "a length that is none"));
    EXPECT_TRUE(contains(refusal_of({{"x", {1}, {std::numeric_limits<float>::quiet_NaN()}}}, form),
                         "not finite"));
    EXPECT_TRUE(contains(refusal_of({}, form), "no tensors by name"));
  }
}

TEST(TorchFileHostile, ForeignNamesAreRefusedByName) {
  EXPECT_TRUE(contains(refusal_of_pickle("cos\nsystem\n(S'echo owned'\ntR."), "'os.system'"));
  for (const char* name :
       {"torchvision.models.vgg\nVGG", "torch\nload", "torch._utils\n_rebuild_sparse_tensor",
        "torch.storage\n_load_from_bytes", "numpy.core.multiarray\n_reconstruct",
        "builtins\ngetattr", "collections\nCounter", "torch\nUntypedStorage"})
    EXPECT_TRUE(contains(refusal_of_pickle("c" + std::string(name) + "\n(tR."), "Python object"))
        << name;
}

TEST(TorchFileHostile, PicklesThatAreNoStateDict) {
  const std::string tensor = "ctorch._utils\n_rebuild_tensor\n";
  for (const std::string& root :
       {std::string("N."), std::string("](I1\ne."), std::string("}."),
        // No storage; a storage that is no tuple; one without a type; a tensor without parts.
        "}S'x'\n" + tensor + "(NI0\n(t(ttRs.", "}S'x'\n" + tensor + "(I1\nQI0\n(t(ttRs.",
        "}S'x'\n" + tensor + "((S'storage'\nNS'100'\nS'cpu'\nI6\ntQI0\n(t(ttRs.",
        "}S'x'\n" + tensor +
            "((S'module'\nctorch\nFloatStorage\nS'100'\nS'cpu'\nI6\ntQI0\n(t(ttRs.",
        "}S'x'\n" + tensor + "((S'storage'\nctorch\nFloatStorage\nS'100'\nS'cpu'\nI6\ntQtRs.",
        // Lengths that overflow, a storage that is not in the archive, one of another length.
        "}S'x'\n" + tensor +
            "((S'storage'\nctorch\nFloatStorage\nS'100'\nS'cpu'\nI4611686018427387905\ntQI0\n(t("
            "ttRs.",
        "}S'x'\n" + tensor + "((S'storage'\nctorch\nFloatStorage\nS'7'\nS'cpu'\nI6\ntQI0\n(t(ttRs.",
        "}S'x'\n" + tensor +
            "((S'storage'\nctorch\nFloatStorage\nS'100'\nS'cpu'\nI5\ntQI0\n(t(ttRs.",
        "}S'x'\n" + tensor +
            "((S'storage'\nctorch\nFloatStorage\nS'100'\nS'cpu'\nI7\ntQI0\n(t(ttRs.",
        // Calls of what is no function, a dictionary of what is no pair.
        std::string("ctorch\nFloatStorage\n)R."),
        std::string("ccollections\nOrderedDict\n(](I1\netR."),
        std::string("ccollections\nOrderedDict\n(I1\ntR."),
        std::string("ccollections\nOrderedDict\n)R}b}bS'x'\nI1\ns.")})
    refusal_of_pickle(root);
}

TEST(TorchFileHostile, OtherContainers) {
  const test::ScratchFolder scratch;
  EXPECT_TRUE(contains(refusal(scratch / "nothing.pth"), "nothing.pth"));
  for (const std::string& bytes :
       {std::string(), std::string("\x80\x02N."), std::string("PK\3\4"), std::string(1000, 'x')}) {
    write_text(scratch / "net.pth", bytes);
    EXPECT_TRUE(contains(refusal(scratch / "net.pth"), "not a readable torch.save file"));
  }
  const std::string root = TorchWriter({}).pickle(kState);
  TorchWriter::write_entries({{"net/data.pkl", root}, {"net/constants.pkl", "N."}},
                             scratch / "script.pt");
  EXPECT_TRUE(contains(refusal(scratch / "script.pt"), "TorchScript"));
  TorchWriter::write_entries({{"net/data.pkl", root}, {"net/byteorder", "big"}},
                             scratch / "big.pt");
  EXPECT_TRUE(contains(refusal(scratch / "big.pt"), "big-endian"));
  TorchWriter::write_entries({{"readme.txt", "hello"}}, scratch / "other.zip");
  EXPECT_TRUE(contains(refusal(scratch / "other.zip"), "data.pkl"));
}

TEST(TorchFileHostile, DamagedBytesNeverCrash) {
  const test::ScratchFolder scratch;
  for (const bool zip : {true, false}) {
    TorchForm form;
    form.zip = zip;
    test::write_torch(kState, scratch / "net.pth", form);
    const std::vector<uint8_t> bytes = read_file(scratch / "net.pth");
    const auto outcome = [&](std::span<const uint8_t> changed) {
      std::ofstream(scratch / "changed.pth", std::ios::binary)
          .write(reinterpret_cast<const char*>(changed.data()),
                 static_cast<std::streamsize>(changed.size()));
      try {
        const TorchFile file(scratch / "changed.pth");
        for (const std::string& name : file.names()) file.read(name);
      } catch (const Error& error) {
        EXPECT_TRUE(contains(error.what(), "changed.pth")) << error.what();
        return false;
      }
      return true;
    };
    for (size_t length = 0; length < bytes.size(); length += 3)
      EXPECT_FALSE(outcome(std::span(bytes).first(length))) << length;
    for (size_t i = 0; i < bytes.size(); ++i) {
      std::vector<uint8_t> changed = bytes;
      changed[i] = static_cast<uint8_t>(changed[i] ^ (i % 2 == 0 ? 0x80 : 0x01));
      outcome(changed);
    }
  }
}

TEST(TorchFile, TheLpipsPackagesHeads) {
  const Path data = test::outside_data("EFFIGY_DATA");
  if (data.empty() || !std::filesystem::exists(data / "perceptual/vgg.pth"))
    GTEST_SKIP() << "set EFFIGY_DATA to a folder with perceptual/vgg.pth to run this";
  const std::vector<std::pair<std::string, size_t>> files = {
      {"alex.pth", 1152}, {"vgg.pth", 1472}, {"squeeze.pth", 2240}};
  for (const auto& [file_name, total] : files) {
    const TorchFile file(data / "perceptual" / file_name);
    size_t count = 0;
    for (const std::string& name : file.names())
      for (const float weight : file.read(name)) {
        EXPECT_GE(weight, 0);
        ++count;
      }
    EXPECT_EQ(count, total);
    EXPECT_EQ(file.shape("lin0.model.1.weight"), (std::vector<int64_t>{1, 64, 1, 1}));
  }
}

}  // namespace
}  // namespace effigy
