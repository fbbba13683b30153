#include "metrics/contact_sheet.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <stdexcept>

namespace splatbus::metrics {
namespace {

constexpr int kMargin = 24, kGap = 12, kMaxSheetSide = 4096;
const cv::Scalar kGround(250, 250, 250), kText(40, 36, 32), kFaintText(110, 104, 100), kFrame(205, 205, 205);

struct Font {
  double scale;
  int thickness;
  int line_height;
};
constexpr Font kTitleFont{0.8, 2, 44}, kColumnFont{0.6, 1, 32}, kCaptionFont{0.55, 1, 28}, kFigureFont{0.5, 1, 23};

int text_width(const std::string& text, const Font& font) {
  int baseline = 0;
  return cv::getTextSize(text, cv::FONT_HERSHEY_SIMPLEX, font.scale, font.thickness, &baseline).width;
}

/// `top` is the upper edge of a line of the font's height.
void put(cv::Mat& canvas, const std::string& text, const cv::Point& left_top, const Font& font,
         const cv::Scalar& color) {
  const int baseline = left_top.y + static_cast<int>(std::lround(0.68 * font.line_height));
  cv::putText(canvas, text, {left_top.x, baseline}, cv::FONT_HERSHEY_SIMPLEX, font.scale, color, font.thickness,
              cv::LINE_AA);
}

int scaled_width(const cv::Mat& picture, int height) {
  return std::clamp(static_cast<int>(std::lround(static_cast<double>(picture.cols) * height / picture.rows)), 1,
                    kMaxSheetSide);
}

void check(const ContactSheet& sheet) {
  if (sheet.columns.empty() || sheet.rows.empty()) throw std::invalid_argument("contact sheet: nothing to show");
  if (sheet.picture_height < 16 || sheet.picture_height > kMaxSheetSide) {
    throw std::invalid_argument(fmt::format("contact sheet: a picture height of {}", sheet.picture_height));
  }
  for (const ContactSheetRow& row : sheet.rows) {
    if (row.pictures.size() > sheet.columns.size()) {
      throw std::invalid_argument(fmt::format("contact sheet: row \"{}\" has {} pictures for {} columns", row.caption,
                                              row.pictures.size(), sheet.columns.size()));
    }
    for (const cv::Mat& picture : row.pictures) {
      if (!picture.empty() && picture.type() != CV_8UC3) {
        throw std::invalid_argument(fmt::format("contact sheet: a picture of row \"{}\" is not CV_8UC3", row.caption));
      }
    }
  }
}

/// Where everything lies, pixels.
struct Grid {
  int captions_width = 0, header_height = 0, row_height = 0;
  std::vector<int> column_left, column_width;
  cv::Size canvas;
};

Grid arrange(const ContactSheet& sheet) {
  Grid grid;
  std::size_t figure_lines = 0;
  for (const ContactSheetRow& row : sheet.rows) {
    grid.captions_width = std::max(grid.captions_width, text_width(row.caption, kCaptionFont));
    for (const std::string& figure : row.figures) {
      grid.captions_width = std::max(grid.captions_width, text_width(figure, kFigureFont));
    }
    figure_lines = std::max(figure_lines, row.figures.size());
  }
  int left = kMargin + (grid.captions_width > 0 ? grid.captions_width + kMargin : 0);
  for (std::size_t c = 0; c < sheet.columns.size(); ++c) {
    int width = text_width(sheet.columns[c], kColumnFont);
    for (const ContactSheetRow& row : sheet.rows) {
      if (c < row.pictures.size() && !row.pictures[c].empty()) {
        width = std::max(width, scaled_width(row.pictures[c], sheet.picture_height));
      }
    }
    grid.column_left.push_back(left);
    grid.column_width.push_back(width);
    left += width + kGap;
  }
  const int text_height = kCaptionFont.line_height + static_cast<int>(figure_lines) * kFigureFont.line_height;
  grid.header_height = kMargin + (sheet.title.empty() ? 0 : kTitleFont.line_height) + kColumnFont.line_height;
  grid.row_height = std::max(sheet.picture_height, text_height) + kGap;
  const int content_right = std::max(left - kGap, kMargin + text_width(sheet.title, kTitleFont));
  grid.canvas = {content_right + kMargin,
                 grid.header_height + static_cast<int>(sheet.rows.size()) * grid.row_height - kGap + kMargin};
  return grid;
}

void draw_row(cv::Mat& canvas, const ContactSheet& sheet, const ContactSheetRow& row, const Grid& grid, int top) {
  put(canvas, row.caption, {kMargin, top}, kCaptionFont, kText);
  int line_top = top + kCaptionFont.line_height;
  for (const std::string& figure : row.figures) {
    put(canvas, figure, {kMargin, line_top}, kFigureFont, kFaintText);
    line_top += kFigureFont.line_height;
  }
  for (std::size_t c = 0; c < row.pictures.size(); ++c) {
    const cv::Mat& picture = row.pictures[c];
    if (picture.empty()) continue;
    const cv::Rect place(grid.column_left[c], top, scaled_width(picture, sheet.picture_height), sheet.picture_height);
    // Nearest when enlarging: a metric's reader wants to see the pixels that were compared.
    const int method = picture.rows >= place.height ? cv::INTER_AREA : cv::INTER_NEAREST;
    cv::Mat target = canvas(place);
    cv::resize(picture, target, place.size(), 0, 0, method);
    cv::rectangle(canvas, {place.x - 1, place.y - 1, place.width + 2, place.height + 2}, kFrame);
  }
}

}  // namespace

cv::Mat draw(const ContactSheet& sheet) {
  check(sheet);
  const Grid grid = arrange(sheet);
  cv::Mat canvas(grid.canvas, CV_8UC3, kGround);
  if (!sheet.title.empty()) put(canvas, sheet.title, {kMargin, kMargin / 2}, kTitleFont, kText);
  const int columns_top = grid.header_height - kColumnFont.line_height;
  for (std::size_t c = 0; c < sheet.columns.size(); ++c) {
    put(canvas, sheet.columns[c], {grid.column_left[c], columns_top}, kColumnFont, kText);
  }
  int top = grid.header_height;
  for (const ContactSheetRow& row : sheet.rows) {
    draw_row(canvas, sheet, row, grid, top);
    top += grid.row_height;
  }
  return canvas;
}

}  // namespace splatbus::metrics
