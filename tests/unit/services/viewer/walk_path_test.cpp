#include "viewer/walk_path.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/gtc/constants.hpp>

namespace splatbus::viewer {
namespace {

constexpr double kQuarter = glm::half_pi<double>();

// An L: 30 m along +x, then 40 m along +z.
const PathLeg kCorner{{0, 1.6F, 0}, {30, 1.6F, 0}, {30, 1.6F, 40}};

TEST(WalkPath, GoesAtItsSpeedRoundCorners) {
  const WalkPath path({kCorner}, {.speed_m_s = 1.4});
  EXPECT_NEAR(path.length_m(), 70, 1e-6);
  EXPECT_NEAR(path.duration_s(), 50, 1e-6);
  EXPECT_NEAR(glm::distance(path.at(10).eye, {14, 1.6F, 0}), 0, 1e-4);
  EXPECT_NEAR(glm::distance(path.at(25).eye, {30, 1.6F, 5}), 0, 1e-4);
  EXPECT_NEAR(glm::distance(path.at(1000).eye, {30, 1.6F, 40}), 0, 1e-4) << "it stays at the end";
  // But at the corner, whose chord is shorter, steps have the length that the speed says.
  for (double t = 0; t < 49.9; t += 0.1) {
    if (std::abs(t * 1.4 - 30) < 0.14) continue;
    EXPECT_NEAR(glm::distance(path.at(t).eye, path.at(t + 0.1).eye), 0.14, 1e-4) << t;
  }
}

TEST(WalkPath, TurnsOverTheTimeAboutACorner) {
  const WalkPath path({kCorner}, {.speed_m_s = 2, .turn_s = 1.5});
  const double corner_s = 15;
  EXPECT_NEAR(path.at(corner_s - 0.76).yaw_radians, 0, 1e-9);
  EXPECT_NEAR(path.at(corner_s).yaw_radians, kQuarter / 2, 1e-9);
  EXPECT_NEAR(path.at(corner_s + 0.375).yaw_radians, kQuarter * 0.75, 1e-9);
  EXPECT_NEAR(path.at(corner_s + 0.76).yaw_radians, kQuarter, 1e-9);
  EXPECT_NEAR(glm::distance(path.at(20).forward(), {0, 0, 1}), 0, 1e-5);
}

TEST(WalkPath, TurnsTheShortWayWhereAnglesWrap) {
  // From a little on one side of -x to a little on the other.
  const WalkPath path({{{0, 0, 0}, {-10, 0, 1}, {-20, 0, 0}}}, {.speed_m_s = 1});
  EXPECT_NEAR(glm::distance(path.at(std::sqrt(101.0)).forward(), {-1, 0, 0}), 0, 1e-3);
}

TEST(WalkPath, HeadingNeverJumpsOnZigzagsAndOnTheWayBack) {
  const PathLeg zigzag{{0, 0, 0}, {1, 0, 0.2F}, {0.4F, 0, 1}, {0.2F, 0, -1}, {-2, 0, -1}, {-2, 0, 0}, {3, 0, 0}};
  const WalkPath path({zigzag}, {.speed_m_s = 1.4, .turn_s = 1, .there_and_back = true, .loop = true});
  // No corner turns by more than half a round, and at most three lie within the second over which turns are spread.
  const double step_s = 0.01;
  for (double t = 0; t < 3 * path.duration_s(); t += step_s) {
    const glm::vec3 a = path.at(t).forward(), b = path.at(t + step_s).forward();
    EXPECT_LT(std::acos(std::min(1.0F, glm::dot(a, b))), 3 * glm::pi<double>() * step_s + 1e-3) << t;
    EXPECT_LT(glm::distance(path.at(t).eye, path.at(t + step_s).eye), 1.4 * step_s + 1e-4) << t;
  }
}

TEST(WalkPath, LeadsBackOverItsOwnWay) {
  const WalkPath path({kCorner}, {.speed_m_s = 1.4, .there_and_back = true});
  EXPECT_NEAR(path.duration_s(), 100, 1e-6);
  for (const double t : {1.0, 20.0, 30.0}) {
    const auto out = path.at(t), back = path.at(100 - t);
    EXPECT_NEAR(glm::distance(out.eye, back.eye), 0, 1e-4) << t;
    EXPECT_NEAR(glm::distance(out.forward(), -back.forward()), 0, 1e-4) << t;
  }
  EXPECT_NEAR(glm::distance(path.at(200).eye, kCorner[0]), 0, 1e-4);
}

TEST(WalkPath, LoopsFromTheBeginning) {
  const WalkPath path({kCorner}, {.speed_m_s = 7, .loop = true});
  EXPECT_NEAR(glm::distance(path.at(11).eye, path.at(1).eye), 0, 1e-4);
  EXPECT_NEAR(glm::distance(path.at(1).eye, {7, 1.6F, 0}), 0, 1e-4);
}

TEST(WalkPath, TeleportsWithoutATurnOrAWay) {
  const WalkPath path({kCorner, {{-50, 1, 0}, {-50, 1, -10}}}, {.speed_m_s = 10, .turn_s = 2});
  EXPECT_NEAR(path.duration_s(), 8, 1e-6) << "the jump takes no time";
  EXPECT_NEAR(glm::distance(path.at(7 - 1e-4).eye, {30, 1.6F, 40}), 0, 1e-2);
  EXPECT_NEAR(glm::distance(path.at(7 - 1e-4).forward(), {0, 0, 1}), 0, 1e-5);
  EXPECT_NEAR(glm::distance(path.at(7 + 1e-4).eye, {-50, 1, 0}), 0, 1e-2);
  EXPECT_NEAR(glm::distance(path.at(7 + 1e-4).forward(), {0, 0, -1}), 0, 1e-5);
}

TEST(WalkPath, TeleportsToAPlaceToStay) {
  const WalkPath path({kCorner, {{-50, 1, 0}}}, {.speed_m_s = 10});
  EXPECT_EQ(path.at(100).eye, glm::vec3(-50, 1, 0));
}

TEST(WalkPath, LooksUpStairsNoFurtherThanItsLimit) {
  const PathLeg stairs{{0, 0, 0}, {0, 0, 4}, {0, 2, 6}, {0, 5, 6}, {0, 5, 10}};
  const double limit = 0.4;  // stairs rise by 45 degrees, the lift by 90
  const WalkPath path({stairs}, {.speed_m_s = 1, .turn_s = 0.5, .pitch_limit_radians = limit});
  EXPECT_NEAR(path.at(5.4).pitch_radians, limit, 1e-9);
  EXPECT_NEAR(path.at(2).pitch_radians, 0, 1e-9);
  EXPECT_NEAR(path.at(8).yaw_radians, kQuarter, 1e-9) << "in the lift the heading stays";
  for (double t = 0; t < path.duration_s(); t += 0.05) EXPECT_LE(path.at(t).pitch_radians, limit + 1e-9);
}

TEST(Spline, GoesThroughItsPointsWithoutKinks) {
  const PathLeg points{{0, 0, 0}, {4, 1, 0}, {5, 1, 3}, {1, 2, 6}, {-3, 0, 5}};
  const PathLeg curve = spline_points(points);
  for (const glm::vec3& point : points) {
    float nearest = 1e9F;
    for (const glm::vec3& at : curve) nearest = std::min(nearest, glm::distance(at, point));
    EXPECT_LT(nearest, 1e-5F);
  }
  // The points turn by 108 degrees at once.
  for (std::size_t i = 2; i < curve.size(); ++i) {
    const glm::vec3 a = glm::normalize(curve[i - 1] - curve[i - 2]), b = glm::normalize(curve[i] - curve[i - 1]);
    EXPECT_GT(glm::dot(a, b), std::cos(glm::radians(12.0F))) << i;
  }
}

TEST(Spline, IsStraightThroughPointsOfALineWhateverTheirDistances) {
  // Uniform knots would run back before the short span (Yuksel et al., figure 2).
  const PathLeg curve = spline_points({{0, 0, 0}, {10, 0, 0}, {10.1F, 0, 0}, {20, 0, 0}});
  for (std::size_t i = 1; i < curve.size(); ++i) {
    EXPECT_GT(curve[i].x, curve[i - 1].x);
    EXPECT_EQ(curve[i].y, 0);
  }
}

}  // namespace
}  // namespace splatbus::viewer
