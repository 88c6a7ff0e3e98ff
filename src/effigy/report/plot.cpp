#include "effigy/report/plot.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "effigy/base/log.h"

namespace effigy::detail {
namespace {

constexpr double kWidth = 960, kHeight = 300;
constexpr double kLeft = 70, kRight = 34, kTop = 12, kBottom = 46;

// One axis: data range mapped to pixels, linear or logarithmic.
struct Axis {
  double low = 0, high = 1, from = 0, to = 1;
  bool log = false;

  double map(double value) const {
    const double t =
        log ? (std::log10(value) - std::log10(low)) / (std::log10(high) - std::log10(low))
            : (value - low) / (high - low);
    return from + t * (to - from);
  }
};

bool drawable(double x, double y, bool log_y) {
  return std::isfinite(x) && std::isfinite(y) && (!log_y || y > 0.0);
}

struct Range {
  double low = std::numeric_limits<double>::infinity();
  double high = -std::numeric_limits<double>::infinity();
  void add(double value) {
    low = std::min(low, value);
    high = std::max(high, value);
  }
};

// Decades, with 2 and 5 between when there are few.
std::vector<double> log_ticks(double low, double high) {
  const int first = static_cast<int>(std::floor(std::log10(low) + 1e-9));
  const int last = static_cast<int>(std::ceil(std::log10(high) - 1e-9));
  const int step = std::max(1, (last - first + 5) / 6);
  std::vector<double> ticks;
  for (int decade = first; decade <= last; decade += step)
    for (const double digit : {1.0, 2.0, 5.0}) {
      if (digit > 1.0 && last - first > 3) break;
      const double value = digit * std::pow(10.0, decade);
      if (value >= low * (1 - 1e-9) && value <= high * (1 + 1e-9)) ticks.push_back(value);
    }
  return ticks;
}

void fit_axes(const LinePlot& plot, Axis& x, Axis& y) {
  Range xs, ys;
  for (const Series& series : plot.series)
    for (size_t i = 0; i < std::min(series.xs.size(), series.ys.size()); ++i)
      if (drawable(series.xs[i], series.ys[i], plot.log_y)) {
        xs.add(series.xs[i]);
        ys.add(series.ys[i]);
      }
  if (xs.low > xs.high) xs = {0, 1}, ys = {plot.log_y ? 0.1 : 0.0, 1};
  if (xs.low == xs.high) xs = {xs.low - 0.5, xs.high + 0.5};
  x = {xs.low, xs.high, kLeft, kWidth - kRight, false};
  if (plot.log_y) {
    // Out to whole decades, or to 1-2-5 steps when the data spans little.
    double low = ys.low, high = ys.high;
    if (low == high) low /= 2, high *= 2;
    const double decade_low = std::pow(10.0, std::floor(std::log10(low)));
    const double decade_high = std::pow(10.0, std::floor(std::log10(high)));
    for (const double digit : {5.0, 2.0, 1.0})
      if (digit * decade_low <= low * (1 + 1e-9)) {
        low = digit * decade_low;
        break;
      }
    for (const double digit : {1.0, 2.0, 5.0, 10.0})
      if (digit * decade_high >= high * (1 - 1e-9)) {
        high = digit * decade_high;
        break;
      }
    y = {low, high, kHeight - kBottom, kTop, true};
    return;
  }
  if (plot.from_zero) ys.add(0.0);
  if (ys.low == ys.high) {
    const double room = ys.low == 0.0 ? 1.0 : 0.1 * std::fabs(ys.low);
    ys = {ys.low - room, ys.high + room};
  }
  const auto ticks = round_ticks(ys.low, ys.high, 5);
  const double step = ticks.size() > 1 ? ticks[1] - ticks[0] : ys.high - ys.low;
  y = {std::floor(ys.low / step + 1e-9) * step, std::ceil(ys.high / step - 1e-9) * step,
       kHeight - kBottom, kTop, false};
}

void draw_axes(const LinePlot& plot, const Axis& x, const Axis& y, std::string& svg) {
  const auto y_ticks = y.log ? log_ticks(y.low, y.high) : round_ticks(y.low, y.high, 5);
  for (const double tick : y_ticks) {
    const double at = y.map(tick);
    svg += format("<line class=rule x1={:.1f} x2={:.1f} y1={:.1f} y2={:.1f} />", kLeft,
                  kWidth - kRight, at, at);
    svg += format("<text x={:.1f} y={:.1f} text-anchor=end>{}</text>", kLeft - 9, at + 4,
                  tick_label(tick));
  }
  svg += format("<line class=axis x1={:.1f} x2={:.1f} y1={:.1f} y2={:.1f} />", kLeft,
                kWidth - kRight, kHeight - kBottom, kHeight - kBottom);
  for (const double tick : round_ticks(x.low, x.high, 8)) {
    const double at = x.map(tick);
    if (at < kLeft - 0.5 || at > kWidth - kRight + 0.5) continue;
    svg += format("<line class=axis x1={:.1f} x2={:.1f} y1={:.1f} y2={:.1f} />", at, at,
                  kHeight - kBottom, kHeight - kBottom + 5);
    svg += format("<text x={:.1f} y={:.1f} text-anchor=middle>{}</text>", at,
                  kHeight - kBottom + 19, tick_label(tick));
  }
  svg += format("<text x={:.1f} y={:.1f} text-anchor=middle>{}</text>",
                (kLeft + kWidth - kRight) / 2, kHeight - 6, escape_html(plot.x_label));
}

struct Point {
  double x, y;
};

// Long curves: at most the first, lowest, highest and last point of every pixel column, in order.
std::vector<Point> thin_out(const std::vector<Point>& points) {
  if (points.size() < 4 * static_cast<size_t>(kWidth)) return points;
  std::vector<Point> kept;
  for (size_t begin = 0; begin < points.size();) {
    size_t end = begin, low = begin, high = begin;
    const double column = std::floor(points[begin].x);
    for (; end < points.size() && std::floor(points[end].x) == column; ++end) {
      if (points[end].y < points[low].y) low = end;
      if (points[end].y > points[high].y) high = end;
    }
    size_t chosen[4] = {begin, std::min(low, high), std::max(low, high), end - 1};
    for (size_t i = 0; i < 4; ++i)
      if (i == 0 || chosen[i] != chosen[i - 1]) kept.push_back(points[chosen[i]]);
    begin = end;
  }
  return kept;
}

void draw_series(const Series& series, size_t index, const Axis& x, const Axis& y,
                 std::string& svg) {
  const size_t count = std::min(series.xs.size(), series.ys.size());
  std::string path;
  std::vector<Point> run;
  const auto flush = [&] {
    bool first = true;
    for (const Point& point : thin_out(run)) {
      path += format("{}{:.1f} {:.1f}", first ? "M" : "L", point.x, point.y);
      first = false;
    }
    if (run.size() == 1) path += "h.1";  // a lone point is a dot
    run.clear();
  };
  for (size_t i = 0; i < count; ++i) {
    if (drawable(series.xs[i], series.ys[i], y.log)) {
      run.push_back({x.map(series.xs[i]), y.map(series.ys[i])});
    } else {
      flush();
    }
  }
  flush();
  if (!path.empty()) svg += format("<path d='{}' stroke='var(--s{})' />", path, index % 8);
  if (count > 60) return;
  for (size_t i = 0; i < count; ++i) {
    if (!drawable(series.xs[i], series.ys[i], y.log)) continue;
    svg += format(
        "<circle cx={:.1f} cy={:.1f} r=3 fill='var(--s{})'><title>{} {}: {}</title></circle>",
        x.map(series.xs[i]), y.map(series.ys[i]), index % 8, escape_html(series.name),
        tick_label(series.xs[i]), tick_label(series.ys[i]));
  }
}

}  // namespace

std::vector<double> round_ticks(double low, double high, int count) {
  if (!(high > low) || !std::isfinite(high - low) || count < 1) return {low};
  const double raw = (high - low) / count;
  const double decade = std::pow(10.0, std::floor(std::log10(raw)));
  // The nearest of 1, 2, 5 and 10 on a logarithmic scale.
  const double digits = raw / decade;
  const double step = decade * (digits < std::sqrt(2.0)    ? 1
                                : digits < std::sqrt(10.0) ? 2
                                : digits < std::sqrt(50.0) ? 5
                                                           : 10);
  std::vector<double> ticks;
  const double first = std::ceil(low / step - 1e-9), last = std::floor(high / step + 1e-9);
  for (double i = first; i <= last && ticks.size() < 100; ++i)
    ticks.push_back(i == 0.0 ? 0.0 : i * step);
  return ticks;
}

std::string tick_label(double value) {
  const double size = std::fabs(value);
  if (value != 0.0 && (size < 1e-4 || size >= 1e7)) return format("{:.3g}", value);
  std::string text = format("{:.6g}", value);
  if (text.find('e') != std::string::npos) text = format("{:.0f}", value);
  const size_t point = std::min(text.find('.'), text.size());
  const size_t begin = text[0] == '-' ? 1 : 0;
  if (point - begin > 4)  // thin spaces between thousands
    for (size_t i = point - 3; i > begin && i < text.size(); i -= 3) text.insert(i, "\u2009");
  if (begin == 1) text.replace(0, 1, "\u2212");
  return text;
}

std::string plot_svg(const LinePlot& plot) {
  Axis x, y;
  fit_axes(plot, x, y);
  std::string svg = format("<svg viewBox='0 0 {:.0f} {:.0f}' role=img aria-label='{}'>", kWidth,
                           kHeight, escape_html(plot.title));
  draw_axes(plot, x, y, svg);
  for (size_t i = 0; i < plot.series.size(); ++i) draw_series(plot.series[i], i, x, y, svg);
  return svg + "</svg>";
}

}  // namespace effigy::detail
