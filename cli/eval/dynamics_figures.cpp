#include "dynamics_figures.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <map>
#include <opencv2/imgproc.hpp>

namespace splatbus::cli {

namespace {

constexpr double kJudged_s = 40;
constexpr int kSsimRadius = 5;

struct Mean {
  double sum = 0;
  std::size_t count = 0;

  void add(double value) {
    sum += value;
    ++count;
  }
  [[nodiscard]] double value() const { return sum / static_cast<double>(count); }
};

}  // namespace

TimeWindow judged_window(double run_s) {
  return {.from_s = run_s - std::min(kJudged_s, run_s * 2 / 3), .to_s = run_s};
}

std::optional<double> mean_within(std::span<const TimedFigure> figures, const TimeWindow& window) {
  Mean mean;
  for (const TimedFigure& figure : figures) {
    if (window.contains(figure.time_s)) mean.add(figure.value);
  }
  if (mean.count == 0) return {};
  return mean.value();
}

std::optional<double> worst_second(std::span<const TimedFigure> figures, const TimeWindow& window) {
  std::map<std::int64_t, Mean> seconds;
  for (const TimedFigure& figure : figures) {
    if (!window.contains(figure.time_s)) continue;
    seconds[static_cast<std::int64_t>(std::floor(figure.time_s - window.from_s))].add(figure.value);
  }
  std::optional<double> worst;
  for (const auto& [second, mean] : seconds) worst = std::min(worst.value_or(mean.value()), mean.value());
  return worst;
}

std::optional<double> kilobits_per_s(std::uint64_t bytes_before, std::uint64_t bytes_after, double seconds) {
  if (seconds <= 0 || bytes_after < bytes_before) return {};
  return static_cast<double>(bytes_after - bytes_before) * 8e-3 / seconds;
}

cv::Mat motion_residual(const cv::Mat& engine_before, const cv::Mat& engine, const cv::Mat& drawn_before,
                        const cv::Mat& drawn) {
  const auto change = [](const cv::Mat& before, const cv::Mat& now) {
    cv::Mat difference;
    cv::subtract(now, before, difference, cv::noArray(), CV_16S);
    return difference;
  };
  cv::Mat residual = cv::abs(change(drawn_before, drawn) - change(engine_before, engine));
  residual.convertTo(residual, CV_8U);
  return residual;
}

cv::Mat grown(const cv::Mat& mask, int pixels) {
  cv::Mat out;
  cv::dilate(mask, out, cv::getStructuringElement(cv::MORPH_RECT, {2 * pixels + 1, 2 * pixels + 1}));
  for (int inset = 0; inset < kSsimRadius; ++inset) {
    cv::rectangle(out, {inset, inset}, {out.cols - 1 - inset, out.rows - 1 - inset}, 0, 1);
  }
  return out;
}

cv::Mat mask_of(const cv::Mat& object_id, const std::set<std::uint32_t>& objects) {
  assert(object_id.type() == CV_32SC1);
  cv::Mat mask = cv::Mat::zeros(object_id.size(), CV_8UC1);
  for (int row = 0; row < mask.rows; ++row) {
    const auto* ids = object_id.ptr<std::int32_t>(row);
    auto* out = mask.ptr<std::uint8_t>(row);
    for (int column = 0; column < mask.cols; ++column) {
      if (objects.contains(static_cast<std::uint32_t>(ids[column]))) out[column] = 255;
    }
  }
  return mask;
}

std::optional<double> masked_mean(const cv::Mat& map, const cv::Mat& mask) {
  assert(map.type() == CV_32FC1 && map.size() == mask.size());
  if (cv::countNonZero(mask) == 0) return {};
  return cv::mean(map, mask)[0];
}

std::optional<double> masked_psnr(const cv::Mat& picture, const cv::Mat& reference, const cv::Mat& mask) {
  if (cv::countNonZero(mask) == 0) return {};
  cv::Mat difference;
  cv::subtract(picture, reference, difference, cv::noArray(), CV_32F);
  const cv::Scalar mean = cv::mean(difference.mul(difference), mask);
  const double square = (mean[0] + mean[1] + mean[2]) / 3;
  return square > 0 ? 10 * std::log10(255.0 * 255.0 / square) : std::numeric_limits<double>::infinity();
}

std::vector<double> return_drops(std::span<const ObjectFigures> seen) {
  struct Known {
    double figure = 0;
    bool away = false;
  };
  std::map<std::uint32_t, Known> known;
  std::vector<double> drops;
  for (const ObjectFigures& picture : seen) {
    for (auto& [id, object] : known) object.away = object.away || !picture.existing.contains(id);
    for (const auto& [id, figure] : picture.of_object) {
      const auto before = known.find(id);
      if (before != known.end() && before->second.away) drops.push_back(before->second.figure - figure);
      known[id] = {.figure = figure, .away = false};
    }
  }
  return drops;
}

void MeanMap::add(const cv::Mat& map) {
  if (sum_.empty()) sum_ = cv::Mat::zeros(map.size(), CV_64FC1);
  cv::Mat wide;
  map.convertTo(wide, CV_64F);
  sum_ += wide;
  ++count_;
}

cv::Mat MeanMap::mean() const {
  cv::Mat mean;
  if (count_ > 0) sum_.convertTo(mean, CV_32F, 1.0 / count_);
  return mean;
}

}  // namespace splatbus::cli
