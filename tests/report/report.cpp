#include "effigy/report/report.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <set>

#include "base/temp_folder.h"
#include "effigy/base/error.h"
#include "effigy/image/files.h"
#include "effigy/report/plot.h"

namespace effigy {
namespace {

size_t count(const std::string& text, const std::string& what) {
  size_t n = 0;
  for (size_t at = text.find(what); at != std::string::npos; at = text.find(what, at + 1)) ++n;
  return n;
}

// Checks that every element that must be closed is closed in order; returns the number of elements.
size_t check_elements(const std::string& html) {
  const std::set<std::string> open_ended = {"meta", "input", "img", "line", "path"};
  std::vector<std::string> stack;
  size_t elements = 0;
  for (size_t i = html.find('<'); i != std::string::npos; i = html.find('<', i + 1)) {
    if (html.compare(i, 2, "<!") == 0) continue;
    const bool closing = html[i + 1] == '/';
    size_t end = i + (closing ? 2 : 1);
    std::string name;
    while (std::isalnum(static_cast<unsigned char>(html[end]))) name += html[end++];
    if (closing) {
      EXPECT_FALSE(stack.empty());
      if (stack.empty()) return elements;
      EXPECT_EQ(stack.back(), name) << html.substr(i > 80 ? i - 80 : 0, 120);
      stack.pop_back();
    } else {
      ++elements;
      if (open_ended.count(name) == 0) stack.push_back(name);
    }
  }
  EXPECT_TRUE(stack.empty());
  return elements;
}

std::vector<uint8_t> from_base64(const std::string& text) {
  const std::string digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::vector<uint8_t> bytes;
  uint32_t group = 0;
  int bits = 0;
  for (char c : text) {
    const size_t digit = digits.find(c);
    if (digit == std::string::npos) break;
    group = (group << 6) | static_cast<uint32_t>(digit);
    if ((bits += 6) >= 8) bytes.push_back(static_cast<uint8_t>(group >> (bits -= 8)));
  }
  return bytes;
}

Report full_report() {
  Report report("Ann & Bob <3", "a 'subtitle' with \"quotes\"");
  report.add_metric_tiles({{"PSNR", "31.2", "dB", "higher"}, {"SSIM", "0.94", "", ""}});
  report.add_heading("One");
  report.add_paragraph("if a < b && c > d");
  report.add_note("<script>alert(1)</script>");
  report.add_code("effigy eval \\\n  avatar");
  report.add_heading("Two");
  report.add_subheading("sub");
  report.add_key_values({{"seed", "1"}, {"rig", "</dl>"}});
  report.add_table({"name", "value"}, {{"x", "1.5 ms"}, {"y", "\u2212 "}, {"z"}}, "caption");
  report.add_bars("times", {{"decode", 2.0, "2 ms"}, {"fit", 4.0, "4 ms"}, {"bad", NAN, "?"}});
  report.add_image(Image8(200, 100, 3, 90), "one picture");
  report.add_image_grid({"a", "b"}, {{"r", {Image8(128, 128, 3, 9), Image8()}}});
  report.add_line_plot({"plot", "x", "y", {{"s", {0, 1, 2}, {1, 2, 3}}, {"t", {}, {}}}});
  return report;
}

TEST(Report, IsOneWholePage) {
  const std::string html = full_report().html();
  EXPECT_GT(check_elements(html), 60u);
  EXPECT_TRUE(html.starts_with("<!DOCTYPE html>"));
  EXPECT_NE(html.find("<title>Ann &amp; Bob &lt;3</title>"), std::string::npos);
  EXPECT_NE(html.find("<a href='#s2'>Two</a>"), std::string::npos);
  EXPECT_NE(html.find("<h2 id=s2>Two</h2>"), std::string::npos);
  // Nothing from outside, no script.
  EXPECT_EQ(html.find("http:"), std::string::npos);
  EXPECT_EQ(html.find("https:"), std::string::npos);
  EXPECT_EQ(html.find("<script"), std::string::npos);
  EXPECT_EQ(html.find("url("), std::string::npos);
  EXPECT_EQ(count(html, "src='"), count(html, "src='data:image/"));
  EXPECT_EQ(count(html, "<img"), 2u);
}

TEST(Report, EscapesText) {
  EXPECT_EQ(escape_html("<a href=\"x\">'&'</a>"),
            "&lt;a href=&quot;x&quot;&gt;&#39;&amp;&#39;&lt;/a&gt;");
  EXPECT_EQ(escape_html("\xc3\xa9 \xe2\x82\xac \xf0\x9f\x99\x82"),
            "\xc3\xa9 \xe2\x82\xac \xf0\x9f\x99\x82");
  // Not UTF-8: a lone byte, an overlong slash, a surrogate, a cut sequence.
  EXPECT_EQ(escape_html("a\xff"
                        "b"),
            "a\ufffd"
            "b");
  EXPECT_EQ(escape_html("\xc0\xaf"), "\ufffd\ufffd");
  EXPECT_EQ(escape_html("\xed\xa0\x80"), "\ufffd\ufffd\ufffd");
  EXPECT_EQ(escape_html("\xe2\x82"), "\ufffd\ufffd");
  EXPECT_EQ(escape_html(std::string("a\0b\x1b\tc\n", 7)), "ab\tc\n");
}

TEST(Report, PicturesAreEmbeddedUnchanged) {
  Image8 image(40, 30, 3);
  for (size_t i = 0; i < image.data.size(); ++i) image.data[i] = static_cast<uint8_t>(i * 31);
  Report report("t");
  PictureStyle style;
  style.embed = Embed::kPng;
  report.add_image(image, "", style);
  const std::string html = report.html();
  const size_t at = html.find("data:image/png;base64,");
  ASSERT_NE(at, std::string::npos);
  EXPECT_EQ(decode_image8(from_base64(html.substr(at + 22)), "embedded").data, image.data);
}

TEST(Report, LargePicturesShrink) {
  Report report("t");
  PictureStyle style;
  style.largest_side = 256;
  report.add_image(Image8(1024, 512, 3, 70), "wide", style);
  const std::string html = report.html();
  const size_t at = html.find("data:image/jpeg;base64,");
  ASSERT_NE(at, std::string::npos);
  const Image8 shown = decode_image8(from_base64(html.substr(at + 23)), "embedded");
  EXPECT_EQ(shown.width, 256);
  EXPECT_EQ(shown.height, 128);
  EXPECT_NEAR(shown.data[0], 70, 2);
}

TEST(Report, NumbersStandRight) {
  Report report("t");
  report.add_table({"name", "ms", "share", "note", "gap"},
                   {{"a", "1 200", "31 %", "3 frames were lost here", ""},
                    {"b", "-0.4 dB", "\u00b1 2", "4", ""},
                    {"c",
                     "\u2212"
                     "3e-4",
                     "\u2013"}});
  const std::string html = report.html();
  EXPECT_NE(html.find("<th>name"), std::string::npos);
  EXPECT_NE(html.find("<th class=num>ms"), std::string::npos);
  EXPECT_NE(html.find("<th class=num>share"), std::string::npos);
  EXPECT_NE(html.find("<th>note"), std::string::npos);
  EXPECT_NE(html.find("<th>gap"), std::string::npos);
  EXPECT_EQ(count(html, "<td"), 15u);
  check_elements(html);
}

TEST(Report, GridsOfAnyShape) {
  Report report("t");
  report.add_image_grid({}, {});
  report.add_image_grid({"only a column"}, {});
  report.add_image_grid({}, {{"", {Image8(8, 8, 1, 5), Image8(8, 8, 4, 5), Image8(8, 8, 3)}}});
  report.add_image_grid({"a"}, {{"x", {}}, {"y", {Image8(8, 8, 3), Image8(8, 8, 3)}}});
  const std::string html = report.html();
  check_elements(html);
  EXPECT_EQ(count(html, "<img"), 5u);
}

TEST(Report, Writes) {
  const test::TempFolder folder;
  const Report report = full_report();
  report.write(folder / "a/report.html");
  EXPECT_EQ(read_text(folder / "a/report.html"), report.html());
  write_text(folder / "file", "");
  EXPECT_THROW(report.write(folder / "file/report.html"), Error);
}

TEST(Plot, RoundTicks) {
  EXPECT_EQ(detail::round_ticks(0, 10, 5), (std::vector<double>{0, 2, 4, 6, 8, 10}));
  EXPECT_EQ(detail::round_ticks(-0.3, 1.1, 3), (std::vector<double>{0, 0.5, 1}));
  EXPECT_EQ(detail::round_ticks(3, 3, 5), std::vector<double>{3});
  for (double span = 1e-9; span < 1e12; span *= 3.7) {
    const auto ticks = detail::round_ticks(-0.3 * span, 0.7 * span, 6);
    EXPECT_GE(ticks.size(), 3u) << span;
    EXPECT_LE(ticks.size(), 10u) << span;
  }
}

TEST(Plot, TickLabels) {
  EXPECT_EQ(detail::tick_label(0), "0");
  EXPECT_EQ(detail::tick_label(0.05), "0.05");
  EXPECT_EQ(detail::tick_label(-2.5),
            "\u2212"
            "2.5");
  EXPECT_EQ(detail::tick_label(2000), "2000");
  EXPECT_EQ(detail::tick_label(12000),
            "12\u2009"
            "000");
  EXPECT_EQ(detail::tick_label(1234567),
            "1\u2009"
            "234\u2009"
            "567");
  EXPECT_EQ(detail::tick_label(1e-7), "1e-07");
}

// All numbers of the paths, as x, y pairs.
std::vector<std::pair<double, double>> path_points(const std::string& svg) {
  std::vector<std::pair<double, double>> points;
  for (size_t at = svg.find("<path d='"); at != std::string::npos; at = svg.find("<path", at + 1))
    for (size_t i = at + 9; svg[i] != '\'';) {
      if (svg[i] != 'M' && svg[i] != 'L') {
        ++i;
        continue;
      }
      char* end = nullptr;
      const double x = std::strtod(svg.c_str() + i + 1, &end);
      const double y = std::strtod(end, &end);
      points.emplace_back(x, y);
      i = static_cast<size_t>(end - svg.c_str());
    }
  return points;
}

TEST(Plot, LinesStayInsideAndRise) {
  const std::string svg = detail::plot_svg({"t", "x", "y", {{"s", {0, 5, 10}, {1.3, 7.7, 9.1}}}});
  const auto points = path_points(svg);
  ASSERT_EQ(points.size(), 3u);
  for (const auto& [x, y] : points) {
    EXPECT_GE(x, 0);
    EXPECT_LE(x, 960);
    EXPECT_GE(y, 0);
    EXPECT_LE(y, 300);
  }
  EXPECT_NEAR(points[1].first, (points[0].first + points[2].first) / 2, 0.11);
  EXPECT_GT(points[0].second, points[1].second);
  EXPECT_NEAR((points[0].second - points[1].second) / (points[0].second - points[2].second),
              (7.7 - 1.3) / (9.1 - 1.3), 0.01);
}

TEST(Plot, LogarithmIsEvenInDecades) {
  LinePlot plot{"t", "x", "y", {{"s", {0, 1, 2, 3}, {10, 1, 0.1, 0.01}}}, true, false};
  const auto points = path_points(detail::plot_svg(plot));
  ASSERT_EQ(points.size(), 4u);
  EXPECT_NEAR(points[1].second - points[0].second, points[3].second - points[2].second, 0.21);
}

TEST(Plot, GapsAndBadValues) {
  const double nan = std::nan(""), infinity = std::numeric_limits<double>::infinity();
  for (const bool log : {false, true}) {
    LinePlot plot{"t", "x", "y", {{"s", {0, 1, 2, 3, 4}, {1, 2, nan, 4, 5}}}, log, false};
    EXPECT_EQ(count(detail::plot_svg(plot), "M"), 2u);
    plot.series = {{"s", {0, 1}, {nan, infinity}}, {"u", {infinity, 3}, {1}}};
    EXPECT_EQ(detail::plot_svg(plot).find("nan"), std::string::npos);
    plot.series = {{"s", {7}, {7}}};  // one point: still a finite scale
    const std::string svg = detail::plot_svg(plot);
    EXPECT_EQ(svg.find("nan"), std::string::npos);
    EXPECT_EQ(svg.find("inf"), std::string::npos);
    EXPECT_EQ(path_points(svg).size(), 1u);
  }
  LinePlot zeros{"t", "x", "y", {{"s", {0, 1, 2}, {0, 0, 0}}}, true, false};
  EXPECT_TRUE(path_points(detail::plot_svg(zeros)).empty());
}

TEST(Plot, LongSeriesAreThinnedButKeepTheirExtremes) {
  Series series{"s", {}, {}};
  for (int i = 0; i < 200000; ++i) {
    series.xs.push_back(i);
    series.ys.push_back(i == 123456 ? 50.0 : std::sin(0.001 * i));
  }
  const std::string svg = detail::plot_svg({"t", "x", "y", {series}});
  EXPECT_LT(svg.size(), 80000u);
  double top = 1e9;
  for (const auto& [x, y] : path_points(svg)) top = std::min(top, y);
  EXPECT_LT(top, 60.0);  // the single spike is still there
}

}  // namespace
}  // namespace effigy
