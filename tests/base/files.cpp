#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>

#include "base/temp_folder.h"
#include "effigy/base/error.h"
#include "effigy/base/file.h"
#include "effigy/base/json.h"
#include "full_disk.h"

namespace effigy {
namespace {

namespace fs = std::filesystem;
using test::FullDisk;
using test::TempFolder;

size_t entries(const Path& folder) {
  return static_cast<size_t>(
      std::distance(fs::directory_iterator(folder), fs::directory_iterator()));
}

template <typename Function>
Error caught(Function&& function) {
  try {
    function();
  } catch (const Error& error) {
    return error;
  }
  ADD_FAILURE() << "no Error was thrown";
  return Error("");
}

bool contains(const Error& error, const std::string& what) {
  return std::string(error.what()).find(what) != std::string::npos;
}

TEST(ReadFile, WholeFileAndErrors) {
  const TempFolder folder;
  write_text(folder / "a.txt", "hello");
  EXPECT_EQ(read_text(folder / "a.txt"), "hello");
  EXPECT_EQ(read_file(folder / "a.txt").size(), 5u);
  write_text(folder / "empty", "");
  EXPECT_TRUE(read_file(folder / "empty").empty());

  const Error missing = caught([&] { read_file(folder / "none"); });
  EXPECT_TRUE(contains(missing, (folder / "none").string()));
  EXPECT_TRUE(contains(missing, "no such file"));
  EXPECT_EQ(missing.exit_code(), 2);
  EXPECT_TRUE(contains(caught([&] { read_file(folder.path()); }), "folder"));
  EXPECT_TRUE(contains(caught([&] { read_file(folder / "a.txt", 4); }), "5 bytes"));
  EXPECT_EQ(read_file(folder / "a.txt", 5).size(), 5u);
}

TEST(WriteFile, CreatesFoldersAndReplaces) {
  const TempFolder folder;
  write_text(folder / "a/b/c.txt", "one");
  write_text(folder / "a/b/c.txt", "two");
  EXPECT_EQ(read_text(folder / "a/b/c.txt"), "two");
  EXPECT_EQ(entries(folder / "a/b"), 1u);
}

TEST(WriteFile, AFullDiskLeavesTheOldFile) {
  const TempFolder folder;
  const Path path = folder / "a.bin";
  write_text(path, "precious");
  const std::vector<uint8_t> big(1 << 20, 7);
  {
    const FullDisk full(64 << 10);
    const Error error = caught([&] { write_file(path, big); });
    EXPECT_EQ(error.blame(), Blame::kResource);
    EXPECT_EQ(error.exit_code(), 1);
    EXPECT_TRUE(contains(error, path.string()));
  }
  EXPECT_EQ(read_text(path), "precious");
  EXPECT_EQ(entries(folder.path()), 1u) << "a temporary file was left behind";
  write_file(path, big);
  EXPECT_EQ(fs::file_size(path), big.size());
}

TEST(WriteFile, PlacesThatCannotBeWritten) {
  const TempFolder folder;
  write_text(folder / "file", "x");
  Error error = caught([&] { write_text(folder / "file/below.txt", "y"); });
  EXPECT_EQ(error.blame(), Blame::kResource);
  EXPECT_TRUE(contains(error, "file"));
  EXPECT_EQ(read_text(folder / "file"), "x");
  // /proc refuses files even to root.
  error = caught([] { write_text("/proc/effigy/a.txt", "y"); });
  EXPECT_EQ(error.blame(), Blame::kResource);
  // A folder where the file should go.
  make_folder(folder / "folder.txt/inner");
  error = caught([&] { write_text(folder / "folder.txt", "y"); });
  EXPECT_EQ(error.blame(), Blame::kResource);
  EXPECT_TRUE(fs::is_directory(folder / "folder.txt/inner"));
  EXPECT_EQ(entries(folder.path()), 2u) << "a temporary file was left behind";
  if (geteuid() == 0) return;  // root may write anywhere
  make_folder(folder / "locked");
  chmod((folder / "locked").c_str(), 0555);
  EXPECT_EQ(caught([&] { write_text(folder / "locked/a", "y"); }).blame(), Blame::kResource);
  chmod((folder / "locked").c_str(), 0755);
}

TEST(WriteThrough, TemporaryIsBesideAndKeepsTheExtension) {
  const TempFolder folder;
  Path seen;
  write_through(folder / "picture.exr", [&](const Path& temporary) {
    seen = temporary;
    EXPECT_FALSE(fs::exists(folder / "picture.exr"));
    write_text(temporary, "x");
  });
  EXPECT_EQ(seen.parent_path(), folder.path());
  EXPECT_EQ(seen.extension(), ".exr");
  EXPECT_FALSE(fs::exists(seen));
  EXPECT_EQ(read_text(folder / "picture.exr"), "x");

  EXPECT_THROW(write_through(folder / "other.exr",
                             [&](const Path& temporary) {
                               write_text(temporary, "half");
                               throw Error("stopped");
                             }),
               Error);
  EXPECT_EQ(entries(folder.path()), 1u);
}

TEST(FolderWriter, AppearsCompleteOrNotAtAll) {
  const TempFolder folder;
  const Path final_path = folder / "out/avatar";
  {
    FolderWriter writer(final_path);
    write_text(writer.dir() / "a.txt", "1");
    EXPECT_FALSE(fs::exists(final_path));
  }
  EXPECT_FALSE(fs::exists(final_path));
  EXPECT_EQ(entries(folder / "out"), 0u) << "an abandoned folder was left behind";
  {
    FolderWriter writer(final_path);
    write_text(writer.dir() / "sub/a.txt", "1");
    writer.commit();
  }
  EXPECT_EQ(read_text(final_path / "sub/a.txt"), "1");
  EXPECT_EQ(entries(folder / "out"), 1u);
}

TEST(FolderWriter, ReplacesTheWholeFolderOnlyAtCommit) {
  const TempFolder folder;
  const Path final_path = folder / "avatar";
  write_text(final_path / "avatar.json", "old");
  write_text(final_path / "old.txt", "old");
  {
    FolderWriter writer(final_path, "avatar.json");
    write_text(writer.dir() / "new.txt", "half");
  }
  EXPECT_EQ(read_text(final_path / "old.txt"), "old");
  // A trailing slash names the same folder.
  FolderWriter writer(final_path.string() + "/", "avatar.json");
  write_text(writer.dir() / "new.txt", "new");
  EXPECT_EQ(read_text(final_path / "old.txt"), "old");
  writer.commit();
  EXPECT_EQ(read_text(final_path / "new.txt"), "new");
  EXPECT_FALSE(fs::exists(final_path / "old.txt"));
  EXPECT_EQ(entries(folder.path()), 1u);
}

TEST(FolderWriter, NobodysFilesAreLost) {
  const TempFolder folder;
  write_text(folder / "thesis/chapter1.txt", "years of work");
  for (const char* marker : {"", "avatar.json"}) {
    const Error error = caught([&] { FolderWriter writer(folder / "thesis", marker); });
    EXPECT_EQ(error.blame(), Blame::kResource);
    EXPECT_TRUE(contains(error, "thesis"));
  }
  EXPECT_EQ(read_text(folder / "thesis/chapter1.txt"), "years of work");
  EXPECT_EQ(entries(folder.path()), 1u) << "a temporary folder was left behind";
  // An empty folder may be filled.
  make_folder(folder / "empty");
  FolderWriter writer(folder / "empty", "avatar.json");
  write_text(writer.dir() / "a.txt", "1");
  writer.commit();
  EXPECT_EQ(read_text(folder / "empty/a.txt"), "1");
}

TEST(FolderWriter, AFileInTheWay) {
  const TempFolder folder;
  write_text(folder / "avatar", "a file");
  const Error error = caught([&] { FolderWriter writer(folder / "avatar"); });
  EXPECT_TRUE(contains(error, "in the way"));
  EXPECT_EQ(read_text(folder / "avatar"), "a file");
  EXPECT_EQ(entries(folder.path()), 1u);
}

TEST(JsonFile, ErrorsNameFileAndField) {
  const TempFolder folder;
  const Path path = folder / "a.json";
  write_json(path, {{"width", 512}, {"name", "jane"}});
  const Json json = read_json(path);
  EXPECT_EQ(json_field<int>(json, "width", path), 512);
  EXPECT_EQ(json_field_or<int>(json, "height", path, 7), 7);
  Error error = caught([&] { json_field<int>(json, "height", path); });
  EXPECT_TRUE(contains(error, path.string()));
  EXPECT_TRUE(contains(error, "'height'"));
  error = caught([&] { json_field<int>(json, "name", path); });
  EXPECT_TRUE(contains(error, "'name'"));
  error = caught([&] { json_field_or<int>(json, "name", path, 3); });
  EXPECT_TRUE(contains(error, "'name'"));
  error = caught([&] { json_field<int>(Json::array({1, 2}), "x", path); });
  EXPECT_TRUE(contains(error, "'x'"));

  for (const char* text : {"", "{", "{\"a\": }", "\xff\xfe", "nul"}) {
    write_text(path, text);
    error = caught([&] { read_json(path); });
    EXPECT_TRUE(contains(error, path.string())) << text;
    EXPECT_EQ(error.exit_code(), 2);
  }
  // Text that is not UTF-8 is still written.
  write_json(path, {{"name", "a\xff"}});
  EXPECT_EQ(read_json(path).at("name"), "a\ufffd");
}

}  // namespace
}  // namespace effigy
