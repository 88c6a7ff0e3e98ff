// --shard i/n: work on frames split among machines, and what scores of the parts are put together
// from.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "effigy/base/json.h"

namespace effigy {

struct Shard {
  int index = 0, count = 1;
  bool whole() const { return count == 1; }
  // Whether the `number`-th piece of the work is this shard's.
  bool takes(size_t number) const {
    return number % static_cast<size_t>(count) == static_cast<size_t>(index);
  }
};
// "i/n", or the whole when empty. Throws Error.
Shard parse_shard(const std::string& text);

// Writes OUT/shards/i-of-n.json. `about` says what was scored and how: alike for all shards.
void write_shard(const Path& out, const Shard& shard, const Json& about, Json scores);
// What the shards in OUT/shards say, in order; `about` becomes theirs. Throws Error when one is
// missing, or they do not belong together.
std::vector<Json> read_shards(const Path& out, Json& about);

// A number that tells this avatar folder from others.
std::string avatar_mark(const Path& avatar);

// Throws Error unless `about` of the shards in OUT/shards says all that `wanted` does: which avatar
// and capture they score.
void check_shards(const Json& about, const Json& wanted, const Path& out);

// Scores as JSON: exact, infinite ones (pictures without a difference) as null.
Json from_scores(const std::vector<double>& scores);
// Throws Error naming `file` unless there are `count`.
std::vector<double> to_scores(const Json& json, size_t count, const Path& file);
// The same for distances by name, in the field `distances` of a JSON object.
Json from_distances(const std::map<std::string, double>& distances);
std::map<std::string, double> to_distances(const Json& scored, const Path& file);

}  // namespace effigy
