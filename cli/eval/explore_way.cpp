#include "explore_way.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <iterator>
#include <stdexcept>

namespace splatbus::cli {

namespace {

constexpr double kAhead_m = 0.01;  // beyond the start, so that there is a way to look along after the teleport
constexpr double kShortest_m = 1;

}  // namespace

double length_m(const viewer::PathLeg& way) {
  double length = 0;
  for (std::size_t i = 1; i < way.size(); ++i) length += glm::distance(way[i - 1], way[i]);
  return length;
}

viewer::PathLeg stretch(const viewer::PathLeg& way, double from_m, double length) {
  viewer::PathLeg part;
  const double to_m = from_m + length;
  double at_m = 0;
  for (std::size_t i = 1; i < way.size(); ++i) {
    const double piece_m = glm::distance(way[i - 1], way[i]);
    const double begin_m = std::max(from_m, at_m), end_m = std::min(to_m, at_m + piece_m);
    if (piece_m > 0 && end_m > begin_m) {
      const auto point = [&](double where_m) {
        return glm::mix(way[i - 1], way[i], static_cast<float>((where_m - at_m) / piece_m));
      };
      if (part.empty()) part.push_back(point(begin_m));
      part.push_back(point(end_m));
    }
    at_m += piece_m;
  }
  return part;
}

const char* to_string(ExplorePhase phase) {
  switch (phase) {
    case ExplorePhase::Out:
      return "out";
    case ExplorePhase::Back:
      return "back";
    case ExplorePhase::Teleported:
      return "teleported";
  }
  return "";
}

ExploreWay::ExploreWay(const viewer::PathLeg& way, double from_m, double out_s, double back_s, double speed_m_s)
    : out_(stretch(way, from_m, out_s * speed_m_s)), speed_m_s_(speed_m_s) {
  if (length_m(out_) < kShortest_m) {
    throw std::runtime_error(
        fmt::format("a way of {:.1f} m leaves nothing to walk from {:.1f} m on", length_m(way), from_m));
  }
  back_ = stretch(viewer::PathLeg(out_.rbegin(), out_.rend()), 0, std::max(kAhead_m, back_s * speed_m_s));
}

ExplorePhase ExploreWay::phase(double time_s) const {
  return time_s < out_s() ? ExplorePhase::Out : time_s < walk_s() ? ExplorePhase::Back : ExplorePhase::Teleported;
}

std::string ExploreWay::path_text() const {
  std::string text;
  const auto add = [&](const glm::vec3& point) {
    text += fmt::format("{:.4f} {:.4f} {:.4f}\n", point.x, point.y, point.z);
  };
  for (const glm::vec3& point : out_) add(point);
  for (auto point = std::next(back_.begin()); point != back_.end(); ++point) add(*point);
  text += "teleport\n";
  for (const glm::vec3& point : stretch(out_, 0, kAhead_m)) add(point);
  return text;
}

std::vector<std::size_t> Stations::pass(ExplorePhase phase, const Camera& walker) {
  std::vector<std::size_t> due;
  if (phase == ExplorePhase::Teleported) return due;
  const glm::vec3& here = walker.world_from_camera.translation;
  const auto distance_m = [&](const Station& station) {
    return glm::distance(station.camera.world_from_camera.translation, here);
  };
  for (std::size_t i = 0; i < stations_.size(); ++i) {
    const bool out = phase == ExplorePhase::Out;
    std::vector<bool>& asked = out ? asked_left_ : asked_back_;
    const bool reached = out ? distance_m(stations_[i]) >= kReach_m : distance_m(stations_[i]) <= kReach_m;
    // One that was not far enough away before the turn has not been left.
    if (asked[i] || !reached || (!out && !asked_left_[i])) continue;
    asked[i] = true;
    due.push_back(i);
  }
  if (phase == ExplorePhase::Out && (stations_.empty() || distance_m(stations_.back()) >= kEvery_m)) {
    stations_.push_back({.camera = walker, .left = {}, .back = {}});
    asked_left_.push_back(false);
    asked_back_.push_back(false);
  }
  return due;
}

void Stations::judge(std::size_t station, ExplorePhase phase, double ssim) {
  (phase == ExplorePhase::Out ? stations_[station].left : stations_[station].back) = ssim;
}

std::optional<Stations::Means> Stations::means() const {
  Means means;
  for (const Station& station : stations_) {
    if (!station.left || !station.back) continue;
    means.left += *station.left;
    means.back += *station.back;
    ++means.stations;
  }
  if (means.stations == 0) return {};
  means.left /= static_cast<double>(means.stations);
  means.back /= static_cast<double>(means.stations);
  return means;
}

double unmodelled_share(const cv::Mat& alpha, const cv::Mat& depth_m) {
  assert(alpha.size() == depth_m.size() && depth_m.type() == CV_32FC1);
  constexpr int kHalf = 128;
  const int channels = alpha.channels();
  std::size_t count = 0;
  for (int row = 0; row < alpha.rows; ++row) {
    const auto* opaque = alpha.ptr<std::uint8_t>(row);
    const auto* surface = depth_m.ptr<float>(row);
    for (int column = 0; column < alpha.cols; ++column) {
      if (surface[column] > 0 && opaque[static_cast<std::ptrdiff_t>(column) * channels] < kHalf) ++count;
    }
  }
  return static_cast<double>(count) / static_cast<double>(alpha.total());
}

}  // namespace splatbus::cli
