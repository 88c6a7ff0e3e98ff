// Scratch memory for vector kernels.
#pragma once

#include <algorithm>
#include <cstddef>
#include <memory>
#include <new>

namespace effigy {

// Growing array of floats on a 64-byte boundary; growing loses what it held.
class AlignedFloats {
 public:
  void reserve(size_t count) {
    if (count <= size_) return;
    data_.reset(static_cast<float*>(::operator new(count * sizeof(float), kAlignment)));
    std::fill_n(data_.get(), count, 0.0f);
    size_ = count;
  }
  size_t size() const { return size_; }
  float* data() { return data_.get(); }
  const float* data() const { return data_.get(); }
  float& operator[](size_t i) { return data_[i]; }
  const float& operator[](size_t i) const { return data_[i]; }

 private:
  static constexpr std::align_val_t kAlignment{64};
  struct Free {
    void operator()(float* p) const { ::operator delete(p, kAlignment); }
  };
  std::unique_ptr<float[], Free> data_;
  size_t size_ = 0;
};

}  // namespace effigy
