#include "metrics/plot.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <opencv2/imgproc.hpp>
#include <stdexcept>

namespace splatbus::metrics {
namespace {

constexpr int kWidth = 960, kHeight = 320;
constexpr int kLeft = 90, kRight = 180, kTop = 44, kBottom = 48;
constexpr int kTicks = 5;
const cv::Scalar kPlotGround(250, 250, 250), kPlotText(40, 36, 32), kGrid(225, 225, 225), kPlotFrame(160, 160, 160),
    kMark(150, 150, 220);
// Okabe and Ito's palette, which those who see few colours tell apart; BGR.
const cv::Scalar kLineColors[] = {{178, 114, 0},   {0, 94, 213},  {115, 158, 0},
                                  {167, 121, 204}, {0, 159, 230}, {66, 66, 66}};

struct Axis {
  double from = 0, to = 1, step = 0.2;
};

/// Bounds at whole steps of 1, 2 or 5 times a power of ten.
Axis axis_of(double least, double most) {
  if (!(most > least)) most = least + 1;
  const double rough = (most - least) / kTicks;
  const double power = std::pow(10.0, std::floor(std::log10(rough)));
  double step = power;
  for (const double factor : {2.0, 5.0, 10.0}) {
    if (step < rough) step = factor * power;
  }
  return {.from = std::floor(least / step) * step, .to = std::ceil(most / step - 1e-9) * step, .step = step};
}

std::vector<double> ticks_of(const Axis& axis) {
  std::vector<double> ticks;
  double at = axis.from;
  while (at <= axis.to + axis.step / 2) {
    ticks.push_back(at);
    at += axis.step;
  }
  return ticks;
}

std::string tick_text(double value, double step) {
  if (std::abs(value) < step / 2) return "0";
  if (std::abs(value) >= 1e6) return fmt::format("{:.4g}M", value / 1e6);
  if (std::abs(value) >= 1e4) return fmt::format("{:.4g}K", value / 1e3);
  return fmt::format("{:.6g}", value);
}

class PlotPainter {
 public:
  PlotPainter(const Plot& plot, cv::Mat canvas) : plot_(plot), canvas_(std::move(canvas)) {
    double most_x = 0, least_x = 0, least_y = plot.y_from, most_y = plot.y_from;
    for (const PlotLine& line : plot.lines) {
      if (line.x.size() != line.y.size()) {
        throw std::invalid_argument(
            fmt::format("plot: line \"{}\" has {} x and {} y", line.name, line.x.size(), line.y.size()));
      }
      for (std::size_t i = 0; i < line.x.size(); ++i) {
        if (!std::isfinite(line.y[i])) continue;
        least_x = std::min(least_x, line.x[i]);
        most_x = std::max(most_x, line.x[i]);
        least_y = std::min(least_y, line.y[i]);
        most_y = std::max(most_y, line.y[i]);
      }
    }
    x_ = axis_of(least_x, most_x);
    y_ = axis_of(least_y, most_y);
  }

  void paint() {
    canvas_.setTo(kPlotGround);
    text(plot_.title, {kLeft, kTop - 18}, 0.55);
    text(plot_.x_label, {kLeft, kHeight - 8}, 0.42);
    for (const double x : ticks_of(x_)) {
      cv::line(canvas_, at(x, y_.from), at(x, y_.to), kGrid);
      text(tick_text(x, x_.step), at(x, y_.from) + cv::Point(-10, 18), 0.42);
    }
    for (const double y : ticks_of(y_)) {
      cv::line(canvas_, at(x_.from, y), at(x_.to, y), kGrid);
      text(tick_text(y, y_.step), at(x_.from, y) + cv::Point(-kLeft + 16, 5), 0.42);
    }
    for (const PlotMark& mark : plot_.marks) {
      cv::line(canvas_, at(mark.x, y_.from), at(mark.x, y_.to), kMark, 2);
      text(mark.name, at(mark.x, y_.to) + cv::Point(4, 12), 0.42);
    }
    cv::rectangle(canvas_, at(x_.from, y_.to), at(x_.to, y_.from), kPlotFrame);
    for (std::size_t i = 0; i < plot_.lines.size(); ++i) {
      const cv::Scalar& color = kLineColors[i % std::size(kLineColors)];
      paint_line(plot_.lines[i], color);
      const cv::Point legend(kWidth - kRight + 16, kTop + 16 + 22 * static_cast<int>(i));
      cv::line(canvas_, legend, legend + cv::Point(20, 0), color, 2, cv::LINE_AA);
      text(plot_.lines[i].name, legend + cv::Point(28, 5), 0.42);
    }
  }

 private:
  [[nodiscard]] cv::Point at(double x, double y) const {
    const double across = (x - x_.from) / (x_.to - x_.from), up = (y - y_.from) / (y_.to - y_.from);
    return {kLeft + static_cast<int>(std::lround(across * (kWidth - kLeft - kRight))),
            kHeight - kBottom - static_cast<int>(std::lround(up * (kHeight - kTop - kBottom)))};
  }

  void text(const std::string& words, const cv::Point& baseline, double scale) {
    cv::putText(canvas_, words, baseline, cv::FONT_HERSHEY_SIMPLEX, scale, kPlotText, 1, cv::LINE_AA);
  }

  void paint_line(const PlotLine& line, const cv::Scalar& color) {
    for (std::size_t i = 0; i < line.x.size(); ++i) {
      if (!std::isfinite(line.y[i])) continue;
      const cv::Point here = at(line.x[i], line.y[i]);
      const bool joined = i > 0 && std::isfinite(line.y[i - 1]);
      cv::line(canvas_, joined ? at(line.x[i - 1], line.y[i - 1]) : here, here, color, 2, cv::LINE_AA);
    }
  }

  const Plot& plot_;
  cv::Mat canvas_;
  Axis x_, y_;
};

}  // namespace

cv::Mat draw(const std::vector<Plot>& plots) {
  if (plots.empty()) throw std::invalid_argument("plot: nothing to show");
  cv::Mat canvas(kHeight * static_cast<int>(plots.size()), kWidth, CV_8UC3);
  int top = 0;
  for (const Plot& plot : plots) {
    PlotPainter(plot, canvas.rowRange(top, top + kHeight)).paint();
    top += kHeight;
  }
  return canvas;
}

}  // namespace splatbus::metrics
