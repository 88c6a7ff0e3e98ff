#include "effigy/learn/training_log.h"

#include <sys/resource.h>

namespace effigy {
namespace {

constexpr int kEvery = 25;

}  // namespace

uint64_t peak_memory_bytes() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<uint64_t>(usage.ru_maxrss) * 1024;
}

void TrainingCurve::add(int64_t iteration, const std::map<std::string, double>& losses) {
  for (const auto& [name, value] : losses) sums_[name] += value;
  if (++count_ < kEvery) return;
  Json entry = {{"iteration", iteration}};
  for (const auto& [name, value] : sums_) entry[name] = value / count_;
  entries_.push_back(entry);
  sums_.clear();
  count_ = 0;
}

void TrainingCurve::add_heldout(int64_t iteration, double psnr) {
  heldout_.push_back({{"iteration", iteration}, {"psnr", psnr}});
}

void TrainingCurve::restore(const Json& training) {
  if (training.contains("losses")) entries_ = training["losses"];
  if (training.contains("heldout")) heldout_ = training["heldout"];
}

}  // namespace effigy
