#include "effigy/learn/up_convolution.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "effigy/learn/up_convolution.cpp"
#include "hwy/foreach_target.h"
// Highway wants these after foreach_target.h.
#include <algorithm>
#include <vector>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "hwy/aligned_allocator.h"
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace effigy {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
template <typename T>
using Tag = hn::ScalableTag<T>;
template <typename T>
using Vec = hn::Vec<Tag<T>>;

// ---- Matrix products ---------------------------------------------------------------------------

// C[r][n] (+)= sum over s < stretches and i < count of
// a[s a_step + r ar + i ak] b[s b_step + i bk + n].
template <typename T>
struct Product {
  const T* a;
  const T* b;
  size_t ar, ak, bk, count;
  size_t stretches;
  ptrdiff_t a_step, b_step;
  bool add;
};

constexpr size_t kRows = 6;  // 6 x 2 vectors of sums, two of b and one of a: 15 of 16 registers

template <size_t kR, size_t kV, typename T>
HWY_INLINE void tile(const Product<T>& p, size_t row, size_t column, T* c, size_t c_row) {
  const Tag<T> d;
  const size_t lanes = hn::Lanes(d);
  Vec<T> sum[kR][kV];
  for (size_t r = 0; r < kR; ++r)
    for (size_t v = 0; v < kV; ++v)
      sum[r][v] = p.add ? hn::LoadU(d, c + r * c_row + v * lanes) : hn::Zero(d);
  const size_t ar = p.ar;
  for (size_t s = 0; s < p.stretches; ++s) {
    const T* HWY_RESTRICT a = p.a + static_cast<ptrdiff_t>(s) * p.a_step + row * ar;
    const T* HWY_RESTRICT b = p.b + static_cast<ptrdiff_t>(s) * p.b_step + column;
    const size_t ak = p.ak, bk = p.bk, count = p.count;
#pragma GCC unroll 4
    for (size_t i = 0; i < count; ++i, a += ak, b += bk) {
      Vec<T> right[kV];
      for (size_t v = 0; v < kV; ++v) right[v] = hn::LoadU(d, b + v * lanes);
      for (size_t r = 0; r < kR; ++r) {
        const Vec<T> left = hn::Set(d, a[r * ar]);
        for (size_t v = 0; v < kV; ++v) sum[r][v] = hn::MulAdd(left, right[v], sum[r][v]);
      }
    }
  }
  for (size_t r = 0; r < kR; ++r)
    for (size_t v = 0; v < kV; ++v) hn::StoreU(sum[r][v], d, c + r * c_row + v * lanes);
}

template <size_t kV, typename T>
HWY_NOINLINE void column_of_tiles(const Product<T>& p, size_t rows, size_t column, T* c,
                                  size_t c_row) {
  size_t row = 0;
  for (; row + kRows <= rows; row += kRows) tile<kRows, kV>(p, row, column, c + row * c_row, c_row);
  c += row * c_row;
  switch (rows - row) {
    case 1:
      return tile<1, kV>(p, row, column, c, c_row);
    case 2:
      return tile<2, kV>(p, row, column, c, c_row);
    case 3:
      return tile<3, kV>(p, row, column, c, c_row);
    case 4:
      return tile<4, kV>(p, row, column, c, c_row);
    case 5:
      return tile<5, kV>(p, row, column, c, c_row);
    default:
      return;
  }
}

// Columns in panels of two vectors; b's panels lie `panel` floats apart (2 Lanes: side by side in
// one row of b). C has room for whole vectors.
template <typename T>
void multiply(const Product<T>& p, size_t rows, size_t columns, size_t panel, T* c, size_t c_row) {
  const Tag<T> d;
  const size_t lanes = hn::Lanes(d);
  for (size_t column = 0; column < columns; column += 2 * lanes) {
    const size_t at = column / (2 * lanes) * panel;
    if (columns - column > lanes)
      column_of_tiles<2>(p, rows, at, c + column, c_row);
    else
      column_of_tiles<1>(p, rows, at, c + column, c_row);
  }
}

template <typename T>
size_t whole_panels(size_t columns) {
  const size_t width = 2 * hn::Lanes(Tag<T>());
  return (columns + width - 1) / width * width;
}

// ---- Bias and activation -----------------------------------------------------------------------

template <typename T>
HWY_INLINE void leaky(const T* x, const T* bias, T* y, size_t n, T slope) {
  const Tag<T> d;
  const size_t lanes = hn::Lanes(d);
  const Vec<T> k = hn::Set(d, slope), zero = hn::Zero(d);
  const size_t whole = n - n % lanes;
  for (size_t i = 0; i < whole; i += lanes) {
    const Vec<T> sum = hn::Add(hn::LoadU(d, x + i), hn::LoadU(d, bias + i));
    hn::StoreU(hn::MulAdd(k, hn::Min(sum, zero), hn::Max(sum, zero)), d, y + i);
  }
  for (size_t i = whole; i < n; ++i) {
    const T sum = x[i] + bias[i];
    y[i] = std::max(sum, T(0)) + slope * std::min(sum, T(0));
  }
}

// d_x = d_y times the slope at y; the same into d_bias unless it is null.
template <typename T>
HWY_INLINE void leaky_backward(const T* y, const T* d_y, T* d_x, T* d_bias, size_t n, T slope) {
  const Tag<T> d;
  const size_t lanes = hn::Lanes(d);
  const Vec<T> k = hn::Set(d, slope), zero = hn::Zero(d);
  const size_t whole = n - n % lanes;
  for (size_t i = 0; i < whole; i += lanes) {
    const Vec<T> up = hn::LoadU(d, d_y + i);
    const Vec<T> down = hn::IfThenElse(hn::Gt(hn::LoadU(d, y + i), zero), up, hn::Mul(k, up));
    hn::StoreU(down, d, d_x + i);
    if (d_bias) hn::StoreU(down, d, d_bias + i);
  }
  for (size_t i = whole; i < n; ++i) {
    d_x[i] = y[i] > T(0) ? d_y[i] : slope * d_y[i];
    if (d_bias) d_bias[i] = d_x[i];
  }
}

// ---- Rows of pictures --------------------------------------------------------------------------

// A block of rows of x, one more than rows of cells, with a pixel of zeros at both ends; rows
// outside are zero.
template <typename T>
class InputRows {
 public:
  InputRows(const UpConvolution& s, const T* x, size_t block)
      : s_(s), x_(x), size_((s.width + 2) * s.in), data_((block + 1) * size_ + kRows) {}
  // Loads what the cells of rows [begin, end) see; row i of the result is row begin + i - 1 of x.
  const T* load(size_t begin, size_t end) {
    const size_t n = s_.width * s_.in;
    for (size_t row = begin; row <= end; ++row) {
      T* to = &data_[(row - begin) * size_];
      if (row == 0 || row > s_.height)
        std::fill_n(to, size_, T(0));
      else
        std::copy_n(x_ + (row - 1) * n, n, to + s_.in);
    }
    return data_.data();
  }
  size_t row_size() const { return size_; }

 private:
  const UpConvolution& s_;
  const T* x_;
  size_t size_;
  std::vector<T> data_;
};

// Rows of cells that are worked on together: long sums for small pictures, and everything in the
// cache for large ones.
size_t block_rows(const UpConvolution& s) {
  constexpr size_t kCells = 128;
  return std::max<size_t>(1, kCells / (s.width + 1));
}

// Calls visit(k, first, count, pixel) for the runs of `count` pixels that cells k make in one row:
// the last pixel of cell 0, both of each cell between, the first of the last cell.
template <typename Visit>
HWY_INLINE void visit_runs(size_t width, Visit&& visit) {
  visit(size_t{0}, size_t{1}, size_t{1}, size_t{0});
  for (size_t k = 1; k < width; ++k) visit(k, size_t{0}, size_t{2}, 2 * k - 1);
  visit(width, size_t{0}, size_t{1}, 2 * width - 1);
}

// ---- Forward -----------------------------------------------------------------------------------

template <typename T>
void forward_rows(const UpConvolution& s, const T* x, const T* packed, const T* bias, T* y,
                  size_t begin, size_t end) {
  const size_t columns = 4 * s.out, c_row = whole_panels<T>(columns), stretch = 2 * s.in;
  const size_t width = 2 * hn::Lanes(Tag<T>());
  InputRows<T> rows(s, x, 1);
  std::vector<T> cells((s.width + 1) * c_row);
  const std::vector<T> twice = [&] {
    std::vector<T> copies(s.tied ? 2 * s.out : 0);
    for (size_t i = 0; i < copies.size(); ++i) copies[i] = bias[i % s.out];
    return copies;
  }();
  for (size_t j = begin; j < end; ++j) {
    Product<T> product;
    product.a = rows.load(j, j + 1);
    product.b = packed;
    product.ar = s.in;
    product.ak = 1;
    product.bk = width;
    product.count = stretch;
    product.stretches = 2;
    product.a_step = static_cast<ptrdiff_t>(rows.row_size());
    product.b_step = static_cast<ptrdiff_t>(stretch * width);
    product.add = false;
    multiply(product, s.width + 1, columns, 2 * stretch * width, cells.data(), c_row);
    for (size_t py = 0; py < 2; ++py) {
      if ((j == 0 && py == 0) || (j == s.height && py == 1)) continue;
      const size_t row = (2 * j + py - 1) * 2 * s.width;
      visit_runs(s.width, [&](size_t k, size_t first, size_t count, size_t pixel) {
        const size_t at = (row + pixel) * s.out;
        leaky(&cells[k * c_row + (2 * py + first) * s.out], s.tied ? twice.data() : bias + at,
              y + at, count * s.out, static_cast<T>(s.slope));
      });
    }
  }
}

// ---- Backward ----------------------------------------------------------------------------------

// What one slot adds up.
template <typename T>
struct Sums {
  std::vector<T> weight;  // [ty, tx, in][whole panels of 4 out]
  std::vector<T> bias;    // [out], tied
};

// The gradient of one row of cells: [width + 1][py, px, out].
template <typename T>
void cell_gradient(const UpConvolution& s, size_t j, const T* y, const T* d_y, T* cells, T* d_bias,
                   Sums<T>* sums) {
  for (size_t py = 0; py < 2; ++py) {
    const bool outside = (j == 0 && py == 0) || (j == s.height && py == 1);
    const size_t row = outside ? 0 : (2 * j + py - 1) * 2 * s.width;
    // The dropped pixels left and right, or the whole dropped row.
    std::fill_n(cells + 2 * py * s.out, outside ? 2 * s.out : s.out, T(0));
    std::fill_n(cells + (s.width * 4 + 2 * py + (outside ? 0 : 1)) * s.out,
                outside ? 2 * s.out : s.out, T(0));
    if (outside) {
      for (size_t k = 1; k < s.width; ++k)
        std::fill_n(cells + (k * 4 + 2 * py) * s.out, 2 * s.out, T(0));
      continue;
    }
    visit_runs(s.width, [&](size_t k, size_t first, size_t count, size_t pixel) {
      const size_t at = (row + pixel) * s.out;
      T* to = cells + (4 * k + 2 * py + first) * s.out;
      leaky_backward(y + at, d_y + at, to, d_bias && !s.tied ? d_bias + at : nullptr, count * s.out,
                     static_cast<T>(s.slope));
      if (sums && s.tied)
        for (size_t i = 0; i < count * s.out; ++i) sums->bias[i % s.out] += to[i];
    });
  }
}

// d_weight += the sum over `count` rows of cells of (what they see) (their gradient).
template <typename T>
void add_weight_gradient(const UpConvolution& s, const T* rows, size_t row_size, const T* cells,
                         size_t count, T* weight) {
  const size_t channels = 4 * s.out, columns = whole_panels<T>(channels);
  Product<T> product;
  product.b = cells;
  product.ar = 1;
  product.ak = s.in;
  product.bk = channels;
  product.count = s.width + 1;
  product.stretches = count;
  product.a_step = static_cast<ptrdiff_t>(row_size);
  product.b_step = static_cast<ptrdiff_t>((s.width + 1) * channels);
  product.add = true;
  for (size_t ty = 0; ty < 2; ++ty) {
    product.a = rows + ty * row_size;
    multiply(product, 2 * s.in, channels, 2 * hn::Lanes(Tag<T>()), weight + ty * 2 * s.in * columns,
             columns);
  }
}

// packed: panels of [ty = 1, 0][tx = 1, 0][py, px, out] x in.
template <typename T>
void backward_rows(const UpConvolution& s, const T* x, const T* packed, const T* y, const T* d_y,
                   T* d_x, T* d_bias, Sums<T>& sums, size_t begin, size_t end) {
  const size_t channels = 4 * s.out, width = 2 * hn::Lanes(Tag<T>()), block = block_rows(s);
  const size_t x_row = whole_panels<T>(s.in), size = (s.width + 1) * channels;
  sums.weight.assign(4 * s.in * whole_panels<T>(channels), T(0));
  sums.bias.assign(s.tied ? s.out : 0, T(0));
  InputRows<T> rows(s, x, block);
  // The row before the block, the block, and what whole vectors read past it.
  std::vector<T> cells((block + 1) * size + width), pixels(s.width * x_row);
  if (begin > 0 && d_x)
    cell_gradient(s, begin - 1, y, d_y, cells.data(), static_cast<T*>(nullptr),
                  static_cast<Sums<T>*>(nullptr));
  Product<T> product;
  product.b = packed;
  product.ar = channels;
  product.ak = 1;
  product.bk = width;
  product.count = 2 * channels;
  product.stretches = 2;
  product.a_step = static_cast<ptrdiff_t>(size);
  product.b_step = static_cast<ptrdiff_t>(2 * channels * width);
  product.add = false;
  for (size_t first = begin; first < end; first += block) {
    const size_t count = std::min(block, end - first);
    for (size_t i = 0; i < count; ++i)
      cell_gradient(s, first + i, y, d_y, &cells[(i + 1) * size], d_bias, &sums);
    add_weight_gradient(s, rows.load(first, first + count), rows.row_size(), &cells[size], count,
                        sums.weight.data());
    for (size_t i = first == 0 ? 1 : 0; d_x && i < count; ++i) {
      product.a = &cells[i * size];
      multiply(product, s.width, s.in, 4 * channels * width, pixels.data(), x_row);
      for (size_t p = 0; p < s.width; ++p)
        std::copy_n(&pixels[p * x_row], s.in, d_x + ((first + i - 1) * s.width + p) * s.in);
    }
    std::copy_n(&cells[count * size], size, cells.data());
  }
}

// ---- Whole pictures ----------------------------------------------------------------------------

// [rows][columns] -> panels of [rows][2 Lanes], zeros after the last column.
template <typename T>
void pack(size_t rows, size_t columns, const T* from, T* packed) {
  const size_t width = 2 * hn::Lanes(Tag<T>());
  parallel_for(whole_panels<T>(columns) / width, 2, [&](size_t begin, size_t end, int) {
    for (size_t panel = begin; panel < end; ++panel) {
      T* to = packed + panel * rows * width;
      const size_t n = std::min(width, columns - panel * width);
      for (size_t r = 0; r < rows; ++r, to += width) {
        std::copy_n(from + r * columns + panel * width, n, to);
        std::fill(to + n, to + width, T(0));
      }
    }
  });
}

// [ty, tx][in][channels] -> panels of [ty = 1, 0][tx = 1, 0][channels][2 Lanes of in].
template <typename T>
void pack_transposed(const UpConvolution& s, const T* weight, T* packed) {
  const size_t channels = 4 * s.out, width = 2 * hn::Lanes(Tag<T>());
  parallel_for(whole_panels<T>(s.in) / width * 4, 2, [&](size_t begin, size_t end, int) {
    for (size_t piece = begin; piece < end; ++piece) {
      const size_t first = piece / 4 * width, tap = 3 - piece % 4;
      const size_t n = std::min(width, s.in - first);
      const T* from = weight + (tap * s.in + first) * channels;
      T* to = packed + piece * channels * width;
      for (size_t c = 0; c < channels; ++c, to += width) {
        for (size_t i = 0; i < n; ++i) to[i] = from[i * channels + c];
        std::fill(to + n, to + width, T(0));
      }
    }
  });
}

constexpr size_t kRowGrain = 4;  // rows of cells worth a thread

template <typename T>
void forward_picture(const UpConvolution& s, const T* x, const T* weight, const T* bias, T* y) {
  const size_t rows = 4 * s.in, columns = 4 * s.out;
  const auto packed = hwy::AllocateAligned<T>(rows * whole_panels<T>(columns));
  pack(rows, columns, weight, packed.get());
  parallel_for(s.height + 1, kRowGrain, [&](size_t begin, size_t end, int) {
    forward_rows(s, x, packed.get(), bias, y, begin, end);
  });
}

template <typename T>
void backward_picture(const UpConvolution& s, const T* x, const T* weight, const T* y, const T* d_y,
                      T* d_x, T* d_weight, T* d_bias) {
  const size_t channels = 4 * s.out, columns = whole_panels<T>(channels);
  const auto packed = hwy::AllocateAligned<T>(4 * channels * whole_panels<T>(s.in));
  if (d_x) pack_transposed(s, weight, packed.get());
  std::vector<Sums<T>> sums(static_cast<size_t>(thread_count()));
  parallel_for(s.height + 1, kRowGrain, [&](size_t begin, size_t end, int slot) {
    backward_rows(s, x, packed.get(), y, d_y, d_x, d_bias, sums[static_cast<size_t>(slot)], begin,
                  end);
  });
  std::fill_n(d_weight, 4 * s.in * channels, T(0));
  if (d_bias && s.tied) std::fill_n(d_bias, s.out, T(0));
  for (const Sums<T>& part : sums) {
    if (part.weight.empty()) continue;
    for (size_t r = 0; r < 4 * s.in; ++r)
      for (size_t c = 0; c < channels; ++c)
        d_weight[r * channels + c] += part.weight[r * columns + c];
    if (d_bias)
      for (size_t i = 0; i < part.bias.size(); ++i) d_bias[i] += part.bias[i];
  }
}

}  // namespace

void forward_float(const UpConvolution& s, const float* x, const float* weight, const float* bias,
                   float* y) {
  forward_picture(s, x, weight, bias, y);
}
void forward_double(const UpConvolution& s, const double* x, const double* weight,
                    const double* bias, double* y) {
  forward_picture(s, x, weight, bias, y);
}
void backward_float(const UpConvolution& s, const float* x, const float* weight, const float* y,
                    const float* d_y, float* d_x, float* d_weight, float* d_bias) {
  backward_picture(s, x, weight, y, d_y, d_x, d_weight, d_bias);
}
void backward_double(const UpConvolution& s, const double* x, const double* weight, const double* y,
                     const double* d_y, double* d_x, double* d_weight, double* d_bias) {
  backward_picture(s, x, weight, y, d_y, d_x, d_weight, d_bias);
}

}  // namespace HWY_NAMESPACE
}  // namespace effigy
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace effigy {
HWY_EXPORT(forward_float);
HWY_EXPORT(forward_double);
HWY_EXPORT(backward_float);
HWY_EXPORT(backward_double);

namespace {
void check(const UpConvolution& s) {
  EFFIGY_CHECK(s.height > 0 && s.width > 0 && s.in > 0 && s.out > 0);
}
}  // namespace

void up_convolution(const UpConvolution& shape, const float* x, const float* weight,
                    const float* bias, float* y) {
  check(shape);
  HWY_DYNAMIC_DISPATCH(forward_float)(shape, x, weight, bias, y);
}
void up_convolution(const UpConvolution& shape, const double* x, const double* weight,
                    const double* bias, double* y) {
  check(shape);
  HWY_DYNAMIC_DISPATCH(forward_double)(shape, x, weight, bias, y);
}

void up_convolution_backward(const UpConvolution& shape, const float* x, const float* weight,
                             const float* y, const float* d_y, float* d_x, float* d_weight,
                             float* d_bias) {
  check(shape);
  HWY_DYNAMIC_DISPATCH(backward_float)(shape, x, weight, y, d_y, d_x, d_weight, d_bias);
}
void up_convolution_backward(const UpConvolution& shape, const double* x, const double* weight,
                             const double* y, const double* d_y, double* d_x, double* d_weight,
                             double* d_bias) {
  check(shape);
  HWY_DYNAMIC_DISPATCH(backward_double)(shape, x, weight, y, d_y, d_x, d_weight, d_bias);
}
}  // namespace effigy
#endif
