#include "viewer/walk_path.h"

#include <algorithm>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <iterator>
#include <utility>

namespace splatbus::viewer {

namespace {

constexpr int kSpanPieces = 32;        // of a spline between two points
constexpr float kSamePlace_m = 1e-4F;  // a step too short to have a direction
constexpr double kSteepest = 1e-3;     // level part of a direction that still has a heading

double wrapped(double angle) {
  return std::remainder(angle, glm::two_pi<double>());
}

PathLeg without_repeats(const PathLeg& points) {
  PathLeg kept;
  for (const glm::vec3& point : points) {
    if (kept.empty() || glm::distance(kept.back(), point) > kSamePlace_m) kept.push_back(point);
  }
  return kept;
}

/// All the way back behind the legs: the last one turns where it ends.
void add_way_back(std::vector<PathLeg>& legs) {
  const std::size_t there = legs.size();
  for (std::size_t i = there; i-- > 0;) {
    PathLeg back(legs[i].rbegin(), legs[i].rend());
    if (i + 1 == there) {
      legs[i].insert(legs[i].end(), std::next(back.begin()), back.end());
    } else {
      legs.push_back(std::move(back));
    }
  }
}

}  // namespace

glm::vec3 WalkPath::Pose::forward() const {
  return {std::cos(pitch_radians) * std::cos(yaw_radians), std::sin(pitch_radians),
          std::cos(pitch_radians) * std::sin(yaw_radians)};
}

WalkPath::WalkPath(std::vector<PathLeg> legs, const Options& options) : options_(options) {
  for (PathLeg& leg : legs) leg = without_repeats(leg);
  if (options_.there_and_back) add_way_back(legs);
  double way_m = 0, yaw = 0;
  for (const PathLeg& points : legs) {
    legs_.push_back(make_leg(points, yaw));
    if (!legs_.back().yaw.empty()) yaw = legs_.back().yaw.back();
    way_m += legs_.back().length_m();
    ends_m_.push_back(way_m);
  }
  Leg& first = legs_.front();
  if (options_.loop && legs_.size() == 1 && !first.yaw.empty() &&
      glm::distance(first.points.front(), first.points.back()) <= kSamePlace_m) {
    first.closed = true;
    first.closing_turn = first.yaw.back() - first.yaw.front() + wrapped(first.yaw.front() - first.yaw.back());
  }
}

WalkPath::Leg WalkPath::make_leg(const PathLeg& points, double yaw_before) const {
  Leg leg{.points = points, .at_m = {0}, .yaw = {}, .pitch = {}, .yaw_integral = {0}, .pitch_integral = {0}};
  double yaw = yaw_before;
  for (std::size_t i = 1; i < points.size(); ++i) {
    const glm::dvec3 step = glm::dvec3(points[i]) - glm::dvec3(points[i - 1]);
    const double length = glm::length(step), level = std::hypot(step.x, step.z);
    // Straight up or down, as in a lift, the heading stays.
    if (level > kSteepest * length) yaw += wrapped(std::atan2(step.z, step.x) - yaw);
    const double pitch = std::atan2(step.y, level);
    leg.yaw.push_back(yaw);
    leg.pitch.push_back(std::clamp(pitch, -options_.pitch_limit_radians, options_.pitch_limit_radians));
    leg.at_m.push_back(leg.at_m.back() + length);
    leg.yaw_integral.push_back(leg.yaw_integral.back() + leg.yaw.back() * length);
    leg.pitch_integral.push_back(leg.pitch_integral.back() + leg.pitch.back() * length);
  }
  if (leg.yaw.empty()) {
    leg.yaw.push_back(yaw_before);
    leg.pitch.push_back(0);
  }
  return leg;
}

std::size_t WalkPath::Leg::segment(double way_m) const {
  const auto after = std::ranges::upper_bound(at_m, way_m);
  const auto index = static_cast<std::size_t>(std::max<std::ptrdiff_t>(0, after - at_m.begin() - 1));
  return std::min(index, yaw.size() - 1);
}

double WalkPath::Leg::integral(const std::vector<double>& direction, const std::vector<double>& sums, double turn,
                               double way_m) const {
  if (closed && way_m < 0) {
    return integral(direction, sums, turn, way_m + length_m()) - sums.back() - turn * way_m;
  }
  if (closed && way_m > length_m()) {
    const double beyond_m = way_m - length_m();
    return sums.back() + integral(direction, sums, turn, beyond_m) + turn * beyond_m;
  }
  const std::size_t i = segment(way_m);
  return sums[i] + direction[i] * (way_m - at_m[i]);
}

WalkPath::Pose WalkPath::pose_at(const Leg& leg, double way_m) const {
  const std::size_t i = leg.segment(way_m);
  Pose pose{.eye = leg.points[i], .yaw_radians = leg.yaw[i], .pitch_radians = leg.pitch[i]};
  if (leg.points.size() < 2) return pose;
  const double length = leg.at_m[i + 1] - leg.at_m[i];
  pose.eye = glm::mix(leg.points[i], leg.points[i + 1],
                      static_cast<float>(std::clamp((way_m - leg.at_m[i]) / length, 0.0, 1.0)));
  // The mean direction of the way just before and after.
  double half_m = options_.speed_m_s * options_.turn_s / 2;
  if (leg.closed) half_m = std::min(half_m, leg.length_m() / 2);
  if (half_m <= 0) return pose;
  const auto mean = [&](const std::vector<double>& direction, const std::vector<double>& sums, double turn) {
    return (leg.integral(direction, sums, turn, way_m + half_m) - leg.integral(direction, sums, turn, way_m - half_m)) /
           (2 * half_m);
  };
  pose.yaw_radians = mean(leg.yaw, leg.yaw_integral, leg.closing_turn);
  pose.pitch_radians = mean(leg.pitch, leg.pitch_integral, 0);
  return pose;
}

WalkPath::Pose WalkPath::at(double seconds) const {
  double way_m = std::max(0.0, seconds) * options_.speed_m_s;
  if (options_.loop && length_m() > 0) way_m = std::fmod(way_m, length_m());
  // Where one leg ends and the next begins, the walker is on the next.
  const auto end = std::ranges::upper_bound(ends_m_, way_m);
  const auto index = std::min(static_cast<std::size_t>(end - ends_m_.begin()), legs_.size() - 1);
  const Leg& leg = legs_[index];
  const double start_m = ends_m_[index] - leg.length_m();
  return pose_at(leg, std::clamp(way_m - start_m, 0.0, leg.length_m()));
}

PathLeg spline_points(const PathLeg& given) {
  PathLeg points = without_repeats(given);
  if (points.size() < 3) return points;
  // A point more at either end, as far beyond it as its neighbour is before.
  points.insert(points.begin(), 2.0F * points[0] - points[1]);
  points.push_back(2.0F * points.back() - points[points.size() - 2]);
  PathLeg curve{points[1]};
  for (std::size_t i = 1; i + 2 < points.size(); ++i) {
    const glm::dvec3 p[4] = {points[i - 1], points[i], points[i + 1], points[i + 2]};
    double knot[4] = {};
    for (int k = 1; k < 4; ++k) knot[k] = knot[k - 1] + std::sqrt(glm::distance(p[k - 1], p[k]));
    for (int piece = 1; piece <= kSpanPieces; ++piece) {
      const double t = knot[1] + (knot[2] - knot[1]) * piece / kSpanPieces;
      const auto between = [&](const glm::dvec3& a, const glm::dvec3& b, int from, int to) {
        return glm::mix(a, b, (t - knot[from]) / (knot[to] - knot[from]));
      };
      const glm::dvec3 a1 = between(p[0], p[1], 0, 1), a2 = between(p[1], p[2], 1, 2), a3 = between(p[2], p[3], 2, 3);
      const glm::dvec3 b1 = between(a1, a2, 0, 2), b2 = between(a2, a3, 1, 3);
      curve.emplace_back(between(b1, b2, 1, 2));
    }
  }
  return curve;
}

}  // namespace splatbus::viewer
