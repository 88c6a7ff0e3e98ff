#include "effigy/cli/shard.h"

#include <cmath>
#include <cstdio>
#include <limits>

#include "effigy/base/hash.h"
#include "effigy/base/log.h"

namespace effigy {
namespace {

Path shard_folder(const Path& out) {
  return out / "shards";
}

Path shard_path(const Path& out, int index, int count) {
  return shard_folder(out) / format("{}-of-{}.json", index, count);
}

// The n of OUT/shards/*-of-n.json.
int count_of_shards(const Path& out) {
  int count = 0;
  std::error_code none;
  for (const auto& entry : std::filesystem::directory_iterator(shard_folder(out), none)) {
    int i = 0, n = 0;
    const std::string name = entry.path().filename().string();
    if (std::sscanf(name.c_str(), "%d-of-%d.json", &i, &n) != 2 ||
        name != format("{}-of-{}.json", i, n))
      continue;
    if (count != 0 && n != count)
      throw Error(shard_folder(out).string() + ": shards of " + std::to_string(count) + " and of " +
                  std::to_string(n) + " lie there; remove those of an earlier run.");
    count = n;
  }
  if (count < 1)
    throw Error(shard_folder(out).string() +
                ": no shards to merge; run effigy eval with --shard i/n and the same -o first.");
  return count;
}

}  // namespace

Shard parse_shard(const std::string& text) {
  Shard shard;
  if (text.empty()) return shard;
  char rest = 0;
  if (std::sscanf(text.c_str(), "%d/%d%c", &shard.index, &shard.count, &rest) != 2 ||
      shard.count < 1 || shard.index < 0 || shard.index >= shard.count)
    throw Error("--shard must be i/n with 0 <= i < n, not '" + text + "'.");
  return shard;
}

void write_shard(const Path& out, const Shard& shard, const Json& about, Json scores) {
  scores["about"] = about;
  make_folder(shard_folder(out));
  write_json(shard_path(out, shard.index, shard.count), scores);
}

std::vector<Json> read_shards(const Path& out, Json& about) {
  const int count = count_of_shards(out);
  std::vector<Json> shards;
  for (int i = 0; i < count; ++i) {
    const Path path = shard_path(out, i, count);
    if (!std::filesystem::exists(path))
      throw Error(path.string() + " is missing: shard " + std::to_string(i) + "/" +
                  std::to_string(count) + " has not ended; run it (again) before merging.");
    shards.push_back(read_json(path));
    const Json its = json_field<Json>(shards.back(), "about", path);
    if (i == 0) about = its;
    if (its != about)
      throw Error(path.string() +
                  ": it scores another avatar or capture, or with other options, than shard 0; "
                  "run it again with the same ones.");
  }
  return shards;
}

std::string avatar_mark(const Path& avatar) {
  const std::string text = read_text(avatar / "avatar.json");
  Hash hash;
  hash.mix(text.data(), text.size());
  return format("{:016x}", hash.value);
}

void check_shards(const Json& about, const Json& wanted, const Path& out) {
  for (const auto& [name, value] : wanted.items())
    if (json_field<Json>(about, name, shard_folder(out)) != value)
      throw Error(shard_folder(out).string() +
                  ": the shards score another avatar or capture; give theirs.");
}

Json from_scores(const std::vector<double>& scores) {
  Json json = Json::array();
  for (const double score : scores) json.push_back(std::isfinite(score) ? Json(score) : Json());
  return json;
}

std::vector<double> to_scores(const Json& json, size_t count, const Path& file) {
  std::vector<double> scores;
  if (json.is_array())
    for (const Json& entry : json) {
      if (!entry.is_null() && !entry.is_number()) break;
      scores.push_back(entry.is_null() ? std::numeric_limits<double>::infinity()
                                       : entry.get<double>());
    }
  if (scores.size() != count)
    throw Error(file.string() + ": a score is not " + std::to_string(count) +
                " numbers; run the shard again.");
  return scores;
}

Json from_distances(const std::map<std::string, double>& distances) {
  Json json = Json::object();
  for (const auto& [name, value] : distances) json[name] = from_scores({value})[0];
  return json;
}

std::map<std::string, double> to_distances(const Json& scored, const Path& file) {
  const Json json = json_field<Json>(scored, "distances", file);
  std::map<std::string, double> distances;
  for (const auto& [name, value] : json.items())
    distances[name] = to_scores(Json::array({value}), 1, file)[0];
  return distances;
}

}  // namespace effigy
