// A report: one static HTML file that explains a result. Nothing is loaded from outside (pictures
// are embedded, plots are SVG, no script), so it can be mailed, archived and opened anywhere; it
// follows the reader's light or dark setting and reads on a phone. All text is escaped.
//
//   Report report("Held-out frames", "jane, 350 frames");
//   report.add_metric_tiles({{"PSNR", "31.2", "dB", "higher is better"}});
//   report.add_heading("Reconstruction");
//   report.add_image_grid({"input", "avatar"}, {{"frame 12", {input, render}}});
//   report.write(out / "report.html");
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "effigy/base/file.h"
#include "effigy/image/image.h"

namespace effigy {

// How pictures are embedded: photographs as JPEG, flat colours (G-buffers, masks) as PNG. kAuto
// takes PNG for pictures with alpha or under 96 pixels, JPEG otherwise.
enum class Embed { kAuto, kJpeg, kPng };

struct PictureStyle {
  Embed embed = Embed::kAuto;
  int jpeg_quality = 88;
  int largest_side = 1024;  // larger pictures are shrunk before they are embedded
  int width = 0;            // shown width of one picture in CSS pixels; 0: what fits
};

struct MetricTile {
  std::string name, value, unit, hint;  // unit and hint may be empty
};

// One row of an image grid; an empty image leaves its cell blank.
struct ImageRow {
  std::string caption;
  std::vector<Image8> images;
};

struct Series {
  std::string name;
  std::vector<double> xs, ys;  // values that are not finite leave a gap
};

struct LinePlot {
  std::string title, x_label, y_label;
  std::vector<Series> series;
  bool log_y = false;      // values <= 0 leave a gap
  bool from_zero = false;  // the y axis starts at 0 (ignored with log_y)
};

struct Bar {
  std::string name;
  double value = 0;   // length, >= 0
  std::string label;  // text beside the bar, e.g. "3.2 ms"
};

class Report {
 public:
  explicit Report(const std::string& title, const std::string& subtitle = {});

  // A section; it also appears in the contents under the title.
  void add_heading(const std::string& text);
  void add_subheading(const std::string& text);
  void add_paragraph(const std::string& text);
  // A paragraph set apart: consent, provenance, warnings.
  void add_note(const std::string& text);
  // Preformatted text, e.g. the command that made the result.
  void add_code(const std::string& text);

  void add_metric_tiles(const std::vector<MetricTile>& tiles);
  void add_key_values(const std::vector<std::pair<std::string, std::string>>& items);
  // Columns whose cells are numbers (with unit, percent sign or spread) are set flush right. Rows
  // may be shorter than `headers`.
  void add_table(const std::vector<std::string>& headers,
                 const std::vector<std::vector<std::string>>& rows,
                 const std::string& caption = {});
  // Horizontal bars on one scale: shares of time, errors by name.
  void add_bars(const std::string& title, const std::vector<Bar>& bars);

  void add_image(const Image8& image, const std::string& caption = {},
                 const PictureStyle& style = {});
  // Column captions stand above the first row, row captions before (on phones above) each row.
  // Clicking a picture enlarges it.
  void add_image_grid(const std::vector<std::string>& columns, const std::vector<ImageRow>& rows,
                      const PictureStyle& style = {});
  void add_line_plot(const LinePlot& plot);

  std::string html() const;
  // Written beside and renamed.
  void write(const Path& path) const;

 private:
  void add_picture(const Image8& image, const std::string& name, const PictureStyle& style);

  std::string title_, subtitle_, body_;
  std::vector<std::string> sections_;
  int pictures_ = 0;
};

// & < > " ' for text and attributes; bytes that are not UTF-8 become U+FFFD, control characters
// other than tab and newline disappear.
std::string escape_html(const std::string& text);

}  // namespace effigy
