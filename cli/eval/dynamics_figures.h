#pragma once

#include <cstdint>
#include <map>
#include <opencv2/core.hpp>
#include <optional>
#include <set>
#include <span>
#include <vector>

namespace splatbus::cli {

/// A figure of one picture at a time of its own, seconds.
struct TimedFigure {
  double time_s = 0;
  double value = 0;
};

/// [from_s, to_s)
struct TimeWindow {
  double from_s = 0, to_s = 0;
  [[nodiscard]] bool contains(double time_s) const { return time_s >= from_s && time_s < to_s; }
};

/// The last 40 s of a run, or its last two thirds where it is shorter than a minute.
[[nodiscard]] TimeWindow judged_window(double run_s);

/// Of the figures within the window; nullopt without any.
[[nodiscard]] std::optional<double> mean_within(std::span<const TimedFigure> figures, const TimeWindow& window);

/// The least mean of a second, seconds counted from the window's start; seconds without a figure do not count, and one
/// that the window cuts off counts with what is in it.
[[nodiscard]] std::optional<double> worst_second(std::span<const TimedFigure> figures, const TimeWindow& window);

/// Rate of a counter of bytes between two readings of it; nullopt when no time passed or it began anew.
[[nodiscard]] std::optional<double> kilobits_per_s(std::uint64_t bytes_before, std::uint64_t bytes_after,
                                                   double seconds);

/// What a drawn picture changes by where the engine's does not, or the other way round, between two instants:
/// |(drawn - drawn before) - (engine - engine before)|, CV_8UC3. Popping and crawling show in it, what is merely off in
/// both does not.
[[nodiscard]] cv::Mat motion_residual(const cv::Mat& engine_before, const cv::Mat& engine, const cv::Mat& drawn_before,
                                      const cv::Mat& drawn);

/// A mask, CV_8UC1, grown by so many pixels (a square). Pixels nearer to the border than SSIM's window is wide count as
/// outside, as in metrics::ssim().
[[nodiscard]] cv::Mat grown(const cv::Mat& mask, int pixels);

/// Where a picture shows one of `objects`: CV_8UC1, 255 or 0. `object_id` is CV_32SC1.
[[nodiscard]] cv::Mat mask_of(const cv::Mat& object_id, const std::set<std::uint32_t>& objects);

/// Mean of a CV_32FC1 map where `mask` is not 0; nullopt where it is 0 everywhere. Both have one size.
[[nodiscard]] std::optional<double> masked_mean(const cv::Mat& map, const cv::Mat& mask);

/// PSNR where `mask` is not 0, of 8-bit pictures, in decibels; nullopt where it is 0 everywhere.
[[nodiscard]] std::optional<double> masked_psnr(const cv::Mat& picture, const cv::Mat& reference, const cv::Mat& mask);

/// By how much a figure falls where an object is that was away and has returned, a return each: the last one before
/// minus the first after it. `seen` has one camera's figures by object, by ascending time.
struct ObjectFigures {
  std::set<std::uint32_t> existing;           ///< objects of the scene
  std::map<std::uint32_t, double> of_object;  ///< those that show
};
[[nodiscard]] std::vector<double> return_drops(std::span<const ObjectFigures> seen);

/// The mean of maps of one size, CV_32FC1, taken in one by one.
class MeanMap {
 public:
  void add(const cv::Mat& map);
  [[nodiscard]] cv::Mat mean() const;  ///< empty before the first add()

 private:
  cv::Mat sum_;  ///< CV_64FC1
  int count_ = 0;
};

}  // namespace splatbus::cli
