// The pickle reader: FLAME's forms are read, everything hostile is refused.
#include "effigy/base/pickle.h"

#include <gtest/gtest.h>

#include "base/pickle_writer.h"
#include "effigy/base/error.h"

namespace effigy {
namespace {

using Kind = PickleValue::Kind;
using test::PickleWriter;

std::string literal(const char* text, size_t size) {
  return std::string(text, size - 1);
}
#define BYTES(text) literal(text, sizeof(text))

Pickle parse(const std::string& bytes) {
  return parse_pickle({reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()}, "m.pkl");
}
// The message of the error that must come.
std::string refusal(const std::string& bytes) {
  try {
    parse(bytes);
  } catch (const Error& error) {
    return error.what();
  }
  return "not refused";
}

TEST(Pickle, PlainValuesOfEveryProtocol) {
  // [None, True, -5, 70000, 2**40, 1.5, 'a', b'b', u'c', (1, 2)] by hand, opcode by opcode.
  const Pickle pickle =
      parse(BYTES("\x80\x02](NI01\nJ\xfb\xff\xff\xffL70000L\n\x8a\x06\x00\x00\x00\x00\x00\x01"
                  "G\x3f\xf8\x00\x00\x00\x00\x00\x00S'a\\x41\\n'\nC\x01"
                  "bX\x02\x00\x00\x00\xc3\xa9K\x01K\x02\x86M\x01\x02\x8a\x01\xff\x8a\x00"
                  "F-2.5\nI-3\n\x89"
                  "e."));
  const PickleValue& root = pickle.root();
  ASSERT_EQ(root.kind, Kind::kList);
  ASSERT_EQ(root.items.size(), 16u);
  EXPECT_EQ(root.items[0]->kind, Kind::kNone);
  EXPECT_EQ(root.items[1]->kind, Kind::kBool);
  EXPECT_EQ(root.items[1]->integer, 1);
  EXPECT_EQ(root.items[2]->integer, -5);
  EXPECT_EQ(root.items[3]->integer, 70000);
  EXPECT_EQ(root.items[4]->integer, int64_t{1} << 40);
  EXPECT_EQ(root.items[5]->number, 1.5);
  EXPECT_EQ(root.items[6]->text, "aA\n");
  EXPECT_EQ(root.items[7]->text, "b");
  EXPECT_EQ(root.items[8]->text, "\xc3\xa9");
  ASSERT_EQ(root.items[9]->kind, Kind::kTuple);
  EXPECT_EQ(root.items[9]->items[1]->integer, 2);
  EXPECT_EQ(root.items[10]->integer, 513);
  EXPECT_EQ(root.items[11]->integer, -1);
  EXPECT_EQ(root.items[12]->integer, 0);
  EXPECT_EQ(root.items[13]->number, -2.5);
  EXPECT_EQ(root.items[14]->integer, -3);
  EXPECT_EQ(root.items[15]->integer, 0);
}

TEST(Pickle, TextProtocolWithMemo) {
  // Protocol 0 of {'a': [1, 2], 'b': the same list}.
  const Pickle pickle = parse("(dp0\nS'a'\np1\n(lp2\nI1\naI2\nasS'b'\np3\ng2\ns.");
  const PickleValue* a = pickle.root().find("a");
  ASSERT_NE(a, nullptr);
  EXPECT_EQ(a, pickle.root().find("b"));
  EXPECT_EQ(a->items[1]->integer, 2);
  EXPECT_EQ(pickle.root().find("c"), nullptr);
}

TEST(Pickle, TextProtocolUnicode) {
  EXPECT_EQ(parse("Va\\u00e9\xe9\\U0001f600\\x\n.").root().text,
            "a\xc3\xa9\xc3\xa9\xf0\x9f\x98\x80\\x");
  EXPECT_NE(refusal("V\\u00e\n.").find("damaged escape"), std::string::npos);
}

class PickleForms : public ::testing::TestWithParam<bool> {};

TEST_P(PickleForms, ArraysSparseMatricesAndChumpy) {
  PickleWriter writer(GetParam());
  const std::vector<int16_t> fortran = {0, 10, 1, 11, 2, 12};
  writer.dictionary({{"array",
                      [&] {
                        writer.array("<f8", {2, 2}, std::vector<double>{1, 2, 3, 4});
                      }},
                     {"fortran",
                      [&] {
                        writer.array("<i2", {2, 3}, fortran.data(), 12, true);
                      }},
                     {"big", [&] { writer.array(">u4", {1}, std::vector<uint32_t>{0x01000000}); }},
                     {"sparse",
                      [&] {
                        writer.csc(2, 3, {5, 6, 7}, {1, 0, 1}, {0, 1, 1, 3});
                      }},
                     {"ch", [&] {
                        writer.chumpy({1, 2}, {8, 9});
                      }}});
  const std::vector<uint8_t> bytes = writer.finish();
  const Pickle pickle = parse_pickle(bytes, "m.pkl");
  const PickleValue& root = pickle.root();
  ASSERT_NE(root.find("array"), nullptr);
  EXPECT_EQ(root.find("array")->array.shape, (std::vector<int64_t>{2, 2}));
  EXPECT_EQ(root.find("array")->array.doubles(), (std::vector<double>{1, 2, 3, 4}));
  EXPECT_EQ(root.find("fortran")->array.integers(), (std::vector<int64_t>{0, 1, 2, 10, 11, 12}));
  EXPECT_EQ(root.find("big")->array.integers(), (std::vector<int64_t>{1}));
  ASSERT_EQ(root.find("sparse")->kind, Kind::kSparse);
  EXPECT_EQ(root.find("sparse")->sparse.dense(), (std::vector<double>{0, 0, 6, 5, 0, 7}));
  ASSERT_EQ(root.find("ch")->kind, Kind::kArray);
  EXPECT_EQ(root.find("ch")->array.doubles(), (std::vector<double>{8, 9}));
  EXPECT_EQ(pickle.globals().count("chumpy.ch.Ch"), 1u);
  // Every truncation is an error, never a crash.
  for (size_t length = 0; length < bytes.size(); ++length)
    EXPECT_THROW(parse_pickle(std::span(bytes).first(length), "m.pkl"), Error) << length;
  // So is, or is not, every changed byte: only the outcome "crash" is wrong.
  for (size_t i = 0; i < bytes.size(); ++i)
    for (const int change : {1, 0x80, 0xFF}) {
      std::vector<uint8_t> changed = bytes;
      changed[i] = static_cast<uint8_t>(changed[i] ^ change);
      try {
        parse_pickle(changed, "m.pkl");
      } catch (const Error&) {
      }
    }
}
INSTANTIATE_TEST_SUITE_P(All, PickleForms, ::testing::Bool());

TEST(Pickle, OtherSpellings) {
  // Bytes that Python 3 writes for protocol 2, a scalar, and protocol 1's reconstructor.
  PickleWriter writer(false);
  writer.dictionary(
      {{"encoded",
        [&] {
          writer.global("_codecs", "encode");
          writer.op(
              BYTES("X\x05\x00\x00\x00"
                    "a\xc3\xbf\xc2\x80"));
          writer.text("latin1");
          writer.op("\x86R");
        }},
       {"scalar",
        [&] {
          writer.global("numpy.core.multiarray", "scalar");
          writer.type("<f8");
          const double value = 2.5;
          writer.data(&value, 8);
          writer.op("\x86R");
        }},
       {"old", [&] {
          writer.global("copy_reg", "_reconstructor");
          writer.op("(");
          writer.global("chumpy.ch", "Ch");
          writer.global("__builtin__", "object");
          writer.op("NtR");
          writer.dictionary({{"x", [&] { writer.array("<f8", {1}, std::vector<double>{3}); }}});
          writer.op("b");
        }}});
  const Pickle pickle = parse_pickle(writer.finish(), "m.pkl");
  EXPECT_EQ(pickle.root().find("encoded")->text, "a\xff\x80");
  EXPECT_EQ(pickle.root().find("encoded")->kind, Kind::kBytes);
  EXPECT_EQ(pickle.root().find("scalar")->array.doubles(), (std::vector<double>{2.5}));
  EXPECT_EQ(pickle.root().find("old")->array.doubles(), (std::vector<double>{3}));
}

TEST(PickleHostile, ForeignNamesAreRefusedByName) {
  const std::string system = refusal("cos\nsystem\n(S'echo owned'\ntR.");
  EXPECT_NE(system.find("'os.system'"), std::string::npos) << system;
  EXPECT_NE(system.find("m.pkl"), std::string::npos);
  EXPECT_NE(system.find("nothing was executed"), std::string::npos);
  EXPECT_NE(refusal(BYTES("\x80\x04\x8c\x08"
                          "builtins\x8c\x04"
                          "eval\x93\x8c\x01"
                          "1\x85R."))
                .find("'builtins.eval'"),
            std::string::npos);
  for (const char* name : {"posix\nsystem", "__builtin__\neval", "builtins\nexec",
                           "builtins\ngetattr", "subprocess\nPopen", "numpy\nload",
                           "numpy.core.multiarray\nfromfile", "numpy\nndarray.tofile", "\n",
                           "builtins\n__import__", "chumpy.ch\nos.system", "copyreg\n__newobj__"})
    EXPECT_NE(refusal("c" + std::string(name) + "\n(tR.").find("Python object"), std::string::npos)
        << name;
  // Control characters of a name do not reach the terminal.
  const std::string escaped = refusal("cos\x1b[31m\nsystem\n.");
  EXPECT_EQ(escaped.find('\x1b'), std::string::npos);
  // A long name is cut.
  EXPECT_LT(refusal("c" + std::string(100000, 'x') + "\ny\n.").size(), 600u);
}

TEST(PickleHostile, StepsThatCallCodeAreRefused) {
  for (const std::string& bytes :
       {std::string("(ios\nsystem\n."),                // INST
        std::string("(cnumpy\nndarray\no."),           // OBJ
        std::string("Pid\n."), std::string("I1\nQ."),  // persistent objects
        BYTES("\x80\x02\x82\x01."), BYTES("\x80\x05\x97."), BYTES("\x80\x05N\x98."),
        BYTES("\x80\x06N.")})
    EXPECT_NE(refusal(bytes).find("m.pkl: not a readable pickle"), std::string::npos);
  EXPECT_NE(refusal(BYTES("\x80\x02)}\x92.")).find("m.pkl"), std::string::npos);  // NEWOBJ_EX
}

TEST(PickleHostile, BrokenStacksAndMemos) {
  for (const char* bytes : {".",        "0.",     "2.",         "a.",
                            "s.",       "t.",     "e.",         "u.",
                            "1.",       "R.",     "b.",         "(.",
                            "((.",      "NNR.",   "Na.",        "]N.extra\xff",
                            "g5\n.",    "h\x05.", "(NNu.",      "}(Nu.",
                            "]NNs.",    "N(N1b.", "NNb.",       "]]b.",
                            "I\n.",     "Ix\n.",  "F\n.",       "L99999999999999999999L\n.",
                            "S'a\n.",   "Sa\n.",  "S'\\x4'\n.", "S'\\'\n.",
                            "q\x01.",   "Nq.",    "cnumpy\n",   "\x85.",
                            "I1\n\x93."}) {
    const std::string text = bytes;
    if (text.rfind("]N.", 0) == 0) {
      EXPECT_NO_THROW(parse(text));  // data after the end is not looked at
      continue;
    }
    EXPECT_NE(refusal(text).find("m.pkl"), std::string::npos) << text;
  }
}

TEST(PickleHostile, DeepNestingIsHarmless) {
  // A list in a list in a list ...: neither reading nor freeing may use the call stack.
  std::string lists(500'000, ']');
  lists += std::string(499'999, 'a') + ".";
  EXPECT_NO_THROW(parse(lists));
  std::string tuples = "N" + std::string(500'000, '\x85') + ".";
  EXPECT_NO_THROW(parse(tuples));
  EXPECT_NE(refusal(std::string(500'000, '(') + ".").find("m.pkl"), std::string::npos);
  // A list that contains itself.
  const Pickle cycle =
      parse(BYTES("\x80\x02]q\x01h\x01"
                  "a."));
  EXPECT_EQ(cycle.root().items[0], &cycle.root());
}

TEST(PickleHostile, SizesThatLieAreRefused) {
  // Strings and integers longer than the file, a memo index of four billion, too many objects.
  for (const std::string& bytes : {BYTES("T\xff\xff\xff\x7f"
                                         "abc."),
                                   BYTES("\x8e\xff\xff\xff\xff\xff\xff\xff\xff"
                                         "abc."),
                                   BYTES("\x8d\x00\x00\x00\x00\x01\x00\x00\x00"
                                         "abc."),
                                   BYTES("\x8b\xff\xff\xff\xff"
                                         "a."),
                                   BYTES("\x8a\x0a"
                                         "0123456789.")})
    EXPECT_NE(refusal(bytes).find("m.pkl"), std::string::npos);
  EXPECT_NO_THROW(parse(BYTES("Nr\xff\xff\xff\xff.")));
  EXPECT_NE(refusal(std::string(1'000'001, 'N') + ".").find("more objects"), std::string::npos);
  EXPECT_NE(refusal("N" + std::string(9'000'000, '2') + ".").find("more steps"), std::string::npos);
}

// One big string used for array after array.
TEST(PickleHostile, ArraysCannotMultiplyMemory) {
  PickleWriter writer(true);
  const std::vector<uint8_t> megabytes(std::size_t{8} << 20);
  const auto size = static_cast<int64_t>(megabytes.size());
  writer.op("](");
  writer.global("numpy._core.numeric", "_frombuffer");  // memo 2
  writer.op("(");
  writer.data(megabytes.data(), megabytes.size());
  writer.type("|u1");
  writer.shape({size});
  writer.text("C");
  writer.op("tr");
  writer.integer(1000, 4);
  writer.op("R");
  for (int i = 0; i < 80; ++i) {
    writer.op(std::string("h\2j", 3));
    writer.integer(1000, 4);
    writer.op("R");
  }
  writer.op("e");
  const auto bytes = writer.finish();
  EXPECT_NE(refusal({bytes.begin(), bytes.end()}).find("512 MiB"), std::string::npos);
}

TEST(PickleHostile, WrongArraysAreRefused) {
  const auto with = [](const std::function<void(PickleWriter&)>& body) {
    PickleWriter writer(true);
    body(writer);
    const auto bytes = writer.finish();
    return refusal({bytes.begin(), bytes.end()});
  };
  const std::vector<double> two = {1, 2};
  EXPECT_NE(with([&](auto& w) { w.array("<f8", {3}, two); }).find("m.pkl"), std::string::npos);
  EXPECT_NE(with([&](auto& w) { w.array("<f8", {-2}, two); }).find("m.pkl"), std::string::npos);
  EXPECT_NE(with([&](auto& w) { w.array("|O", {2}, two); }).find("m.pkl"), std::string::npos);
  EXPECT_NE(with([&](auto& w) {
              w.array("<f8", {int64_t{1} << 62, 4}, two);
            }).find("m.pkl"),
            std::string::npos);
  // Sparse matrices whose indices lie.
  for (const auto& [indices, starts] :
       std::vector<std::pair<std::vector<int32_t>, std::vector<int32_t>>>{{{0, 2}, {0, 1, 2}},
                                                                          {{0, -1}, {0, 1, 2}},
                                                                          {{0, 1}, {0, 3, 2}},
                                                                          {{0, 1}, {0, 1, 3}},
                                                                          {{0, 1}, {1, 1, 2}},
                                                                          {{0, 1}, {0, -1, 2}}})
    EXPECT_NE(
        with([&, &i = indices, &s = starts](auto& w) { w.csc(2, 2, two, i, s); }).find("sparse"),
        std::string::npos);
  EXPECT_NE(with([&](auto& w) {
              w.csc(2000000000, 2, two, {0, 1}, {0, 1, 2});
            }).find("too large"),
            std::string::npos);
}

}  // namespace
}  // namespace effigy
