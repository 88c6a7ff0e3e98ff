#include "effigy/report/report.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "effigy/base/error.h"
#include "effigy/base/log.h"
#include "effigy/image/files.h"
#include "effigy/image/resample.h"
#include "effigy/report/plot.h"
#include "effigy/report/style.h"

namespace effigy {
namespace {

std::string base64(const std::vector<uint8_t>& bytes) {
  static constexpr char digits[] =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  for (size_t i = 0; i < bytes.size(); i += 3) {
    const size_t left = std::min<size_t>(3, bytes.size() - i);
    uint32_t group = static_cast<uint32_t>(bytes[i]) << 16;
    if (left > 1) group |= static_cast<uint32_t>(bytes[i + 1]) << 8;
    if (left > 2) group |= bytes[i + 2];
    for (size_t k = 0; k < 4; ++k) text += k <= left ? digits[(group >> (18 - 6 * k)) & 63] : '=';
  }
  return text;
}

// Length of the well-formed UTF-8 sequence at text[i], 0 when there is none.
size_t utf8_length(const std::string& text, size_t i) {
  const auto byte = [&](size_t k) {
    return k < text.size() ? static_cast<unsigned char>(text[k]) : 0u;
  };
  const auto follows = [&](size_t k) { return (byte(k) & 0xc0u) == 0x80u; };
  const unsigned c = byte(i);
  if (c < 0x80) return 1;
  if (c >= 0xc2 && c < 0xe0) return follows(i + 1) ? 2 : 0;
  if (c >= 0xe0 && c < 0xf0) {
    if (!follows(i + 1) || !follows(i + 2)) return 0;
    const bool overlong = c == 0xe0 && byte(i + 1) < 0xa0;
    const bool surrogate = c == 0xed && byte(i + 1) >= 0xa0;
    return overlong || surrogate ? 0 : 3;
  }
  if (c >= 0xf0 && c < 0xf5) {
    if (!follows(i + 1) || !follows(i + 2) || !follows(i + 3)) return 0;
    const bool overlong = c == 0xf0 && byte(i + 1) < 0x90;
    const bool beyond = c == 0xf4 && byte(i + 1) >= 0x90;
    return overlong || beyond ? 0 : 4;
  }
  return 0;
}

// "31.2", "-0.4 dB", "12 ms", "98 %", "3.1 +- 0.2", "1 200", "1e-3", "1:02": digits with signs and
// spaces, perhaps a short unit. A dash stands for a missing number.
bool is_number_cell(const std::string& cell) {
  if (cell.empty() || cell == "-" || cell == "\u2013" || cell == "\u2014") return true;
  size_t i = 0;
  for (const char* sign : {"+", "-", "\u2212", "\u00b1"})
    if (cell.starts_with(sign)) i = std::strlen(sign);
  while (i < cell.size() && cell[i] == ' ') ++i;
  if (i >= cell.size() || (!std::isdigit(static_cast<unsigned char>(cell[i])) && cell[i] != '.'))
    return false;
  size_t letters = 0;
  for (; i < cell.size(); ++i)
    if (std::isalpha(static_cast<unsigned char>(cell[i]))) ++letters;
  return letters <= 6;
}

std::string section_id(size_t index) {
  return "s" + std::to_string(index + 1);
}

}  // namespace

std::string escape_html(const std::string& text) {
  std::string out;
  out.reserve(text.size());
  for (size_t i = 0; i < text.size();) {
    const size_t length = utf8_length(text, i);
    if (length == 0) {
      out += "\ufffd";
      ++i;
      continue;
    }
    const char c = text[i];
    switch (length == 1 ? c : 'x') {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      case '\'':
        out += "&#39;";
        break;
      default: {
        const auto code = static_cast<unsigned char>(c);
        const bool control = (code < 32 && c != '\n' && c != '\t') || code == 127;
        if (!control) out.append(text, i, length);
      }
    }
    i += length;
  }
  return out;
}

Report::Report(const std::string& title, const std::string& subtitle)
    : title_(title), subtitle_(subtitle) {}

void Report::add_heading(const std::string& text) {
  body_ += "<h2 id=" + section_id(sections_.size()) + ">" + escape_html(text) + "</h2>\n";
  sections_.push_back(text);
}

void Report::add_subheading(const std::string& text) {
  body_ += "<h3>" + escape_html(text) + "</h3>\n";
}

void Report::add_paragraph(const std::string& text) {
  body_ += "<p>" + escape_html(text) + "</p>\n";
}

void Report::add_note(const std::string& text) {
  body_ += "<p class=note>" + escape_html(text) + "</p>\n";
}

void Report::add_code(const std::string& text) {
  body_ += "<pre>" + escape_html(text) + "</pre>\n";
}

void Report::add_metric_tiles(const std::vector<MetricTile>& tiles) {
  // Rows of equal length, at most six tiles each.
  const size_t rows = (tiles.size() + 5) / 6;
  const size_t columns = rows > 0 ? (tiles.size() + rows - 1) / rows : 1;
  body_ += format("<div class=tiles style='--n:{}'>\n", std::max<size_t>(columns, 3));
  for (const MetricTile& tile : tiles) {
    body_ += "<div class=tile><div class=name>" + escape_html(tile.name) +
             "</div><div class=value>" + escape_html(tile.value);
    if (!tile.unit.empty()) body_ += "<span class=unit>" + escape_html(tile.unit) + "</span>";
    body_ += "</div>";
    if (!tile.hint.empty()) body_ += "<div class=hint>" + escape_html(tile.hint) + "</div>";
    body_ += "</div>\n";
  }
  body_ += "</div>\n";
}

void Report::add_key_values(const std::vector<std::pair<std::string, std::string>>& items) {
  body_ += "<dl>\n";
  for (const auto& [key, value] : items)
    body_ += "<div><dt>" + escape_html(key) + "</dt><dd>" + escape_html(value) + "</dd></div>\n";
  body_ += "</dl>\n";
}

void Report::add_table(const std::vector<std::string>& headers,
                       const std::vector<std::vector<std::string>>& rows,
                       const std::string& caption) {
  std::vector<bool> numeric(headers.size(), true);
  for (size_t c = 0; c < headers.size(); ++c) {
    bool any = false;
    for (const auto& row : rows) {
      if (c >= row.size()) continue;
      any = any || !row[c].empty();
      numeric[c] = numeric[c] && is_number_cell(row[c]);
    }
    numeric[c] = numeric[c] && any;
  }
  body_ += "<div class=scroll><table>";
  if (!caption.empty()) body_ += "<caption>" + escape_html(caption) + "</caption>";
  body_ += "<thead><tr>";
  for (size_t c = 0; c < headers.size(); ++c)
    body_ += (numeric[c] ? "<th class=num>" : "<th>") + escape_html(headers[c]) + "</th>";
  body_ += "</tr></thead><tbody>\n";
  for (const auto& row : rows) {
    EFFIGY_CHECK(row.size() <= headers.size());
    body_ += "<tr>";
    for (size_t c = 0; c < headers.size(); ++c)
      body_ += (numeric[c] ? "<td class=num>" : "<td>") +
               (c < row.size() ? escape_html(row[c]) : std::string()) + "</td>";
    body_ += "</tr>\n";
  }
  body_ += "</tbody></table></div>\n";
}

void Report::add_bars(const std::string& title, const std::vector<Bar>& bars) {
  double longest = 0.0;
  for (const Bar& bar : bars)
    if (std::isfinite(bar.value)) longest = std::max(longest, bar.value);
  body_ += "<div class=bars>";
  if (!title.empty()) body_ += "<h4>" + escape_html(title) + "</h4>";
  for (const Bar& bar : bars) {
    const double share = longest > 0.0 && bar.value > 0.0 ? bar.value / longest : 0.0;
    body_ += "<div class=bar><span>" + escape_html(bar.name) +
             format("</span><span class=track><div class=fill style='width:{:.2f}%'></div></span>",
                    100.0 * std::min(share, 1.0)) +
             "<span class=label>" + escape_html(bar.label) + "</span></div>\n";
  }
  body_ += "</div>\n";
}

void Report::add_picture(const Image8& image, const std::string& name, const PictureStyle& style) {
  EFFIGY_CHECK(image.channels == 1 || image.channels == 3 || image.channels == 4);
  const Image8* shown = &image;
  Image8 smaller;
  const int side = std::max(image.width, image.height);
  if (style.largest_side > 0 && side > style.largest_side) {
    const double scale = static_cast<double>(style.largest_side) / side;
    smaller = resize(image, std::max(1, static_cast<int>(std::lround(image.width * scale))),
                     std::max(1, static_cast<int>(std::lround(image.height * scale))));
    shown = &smaller;
  }
  const bool png = style.embed == Embed::kPng ||
                   (style.embed == Embed::kAuto && (image.channels == 4 || side < 96));
  const auto bytes = png ? encode_png8(*shown) : encode_jpeg(*shown, style.jpeg_quality);
  const std::string alt = escape_html(name.empty() ? "picture" : name);
  ++pictures_;
  body_ += format("<label class='zoom{}'><input type=checkbox aria-label='enlarge {}'>",
                  side < 96 ? " small" : "", alt);
  body_ +=
      format("<img alt='{}' width={} height={}{} src='data:image/{};base64,", alt, shown->width,
             shown->height, pictures_ > 8 ? " loading=lazy" : "", png ? "png" : "jpeg");
  body_ += base64(bytes);
  body_ += "'></label>";
}

void Report::add_image(const Image8& image, const std::string& caption, const PictureStyle& style) {
  const int width = style.width > 0 ? style.width : image.width;
  body_ += format("<figure><div style='max-width:{}px'>", std::min(width, 1024));
  add_picture(image, caption, style);
  body_ += "</div>";
  if (!caption.empty()) body_ += "<figcaption>" + escape_html(caption) + "</figcaption>";
  body_ += "</figure>\n";
}

void Report::add_image_grid(const std::vector<std::string>& columns,
                            const std::vector<ImageRow>& rows, const PictureStyle& style) {
  size_t count = columns.size();
  bool named = false;
  for (const ImageRow& row : rows) {
    count = std::max(count, row.images.size());
    named = named || !row.caption.empty();
  }
  if (count == 0) return;
  const std::string widest = style.width > 0 ? std::to_string(style.width) + "px" : "1fr";
  const int least = style.width > 0 ? std::min(style.width, 110) : 110;
  body_ += format(
      "<div class='grid{}' style='--n:{};--least:{}px;grid-template-columns:{}"
      "repeat({},minmax({}px,{}))'>\n",
      named ? " named" : "", count, least, named ? "minmax(64px,96px) " : "", count, least, widest);
  if (!columns.empty()) {
    if (named) body_ += "<span class=corner></span>";
    for (size_t c = 0; c < count; ++c)
      body_ += "<span class=col>" + (c < columns.size() ? escape_html(columns[c]) : "") + "</span>";
  }
  for (const ImageRow& row : rows) {
    if (named) body_ += "<span class=row>" + escape_html(row.caption) + "</span>";
    for (size_t c = 0; c < count; ++c) {
      if (c >= row.images.size() || row.images[c].empty()) {
        body_ += "<span></span>";
        continue;
      }
      const std::string column = c < columns.size() ? columns[c] : "";
      add_picture(row.images[c],
                  row.caption + (row.caption.empty() || column.empty() ? "" : ", ") + column,
                  style);
    }
    body_ += "\n";
  }
  body_ += "</div>\n";
}

void Report::add_line_plot(const LinePlot& plot) {
  body_ += "<div class=plot>";
  if (!plot.title.empty()) body_ += "<h4>" + escape_html(plot.title) + "</h4>";
  body_ += "<div class=legend>";
  if (!plot.y_label.empty()) body_ += "<span>" + escape_html(plot.y_label) + "</span>";
  for (size_t i = 0; i < plot.series.size() && plot.series.size() > 1; ++i)
    body_ += format("<span><i style='background:var(--s{})'></i>{}</span>", i % 8,
                    escape_html(plot.series[i].name));
  body_ += "</div>";
  body_ += "<div class=scroll>" + detail::plot_svg(plot) + "</div></div>\n";
}

std::string Report::html() const {
  std::string page =
      "<!DOCTYPE html>\n<html lang=en>\n<head>\n<meta charset=utf-8>\n"
      "<meta name=viewport content='width=device-width, initial-scale=1'>\n"
      "<meta http-equiv=Content-Security-Policy content=\"default-src 'none'; img-src data:; "
      "style-src 'unsafe-inline'\">\n<meta name=generator content='Effigy " EFFIGY_VERSION
      "'>\n<title>" +
      escape_html(title_) + "</title>\n<style>";
  page += detail::kReportStyle;
  page += "</style>\n</head>\n<body>\n<main>\n<header><h1>" + escape_html(title_) + "</h1>";
  if (!subtitle_.empty()) page += "<p class=subtitle>" + escape_html(subtitle_) + "</p>";
  if (sections_.size() > 1) {
    page += "<nav aria-label=contents>";
    for (size_t i = 0; i < sections_.size(); ++i)
      page += "<a href='#" + section_id(i) + "'>" + escape_html(sections_[i]) + "</a>";
    page += "</nav>";
  }
  page += "</header>\n" + body_ +
          "<footer>Effigy " EFFIGY_VERSION "</footer>\n</main>\n</body>\n</html>\n";
  return page;
}

void Report::write(const Path& path) const {
  write_text(path, html());
}

}  // namespace effigy
