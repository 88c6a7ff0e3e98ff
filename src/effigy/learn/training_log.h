// What a training run writes down about itself: curves of losses and of held-out scores, memory.
#pragma once

#include <cstdint>
#include <map>
#include <string>

#include "effigy/base/json.h"

namespace effigy {

// Largest resident memory of this process so far.
uint64_t peak_memory_bytes();

// The curves that reports draw: one entry of mean losses every few iterations.
class TrainingCurve {
 public:
  void add(int64_t iteration, const std::map<std::string, double>& losses);
  void add_heldout(int64_t iteration, double psnr);
  Json losses() const { return entries_; }
  Json heldout() const { return heldout_; }
  // Goes on from the file of an interrupted run (its fields "losses" and "heldout").
  void restore(const Json& training);

 private:
  int count_ = 0;
  std::map<std::string, double> sums_;
  Json entries_ = Json::array(), heldout_ = Json::array();
};

}  // namespace effigy
