#include "shadow_mask.h"

#include <gtest/gtest.h>

#include <cmath>

namespace splatbus::cli {
namespace {

// A floor at y = 0 and a lid of 1 m x 1 m at y = 1 above the origin, the sun straight above.
constexpr float kLid_m = 1, kTop_m = 5, kTexels_per_m = 100;

relight::LightMaps sun_above() {
  relight::LightMaps::Map map;
  const auto depth_m = std::make_shared<std::vector<float>>();
  map.camera = look_at({0, kTop_m, 0}, {0, 0, 0.001F}, 400, 400, 1);
  map.camera.role = CameraRole::Light;
  map.camera.fx = map.camera.fy = kTexels_per_m;
  map.camera.cx = map.camera.cy = 200;
  for (int row = 0; row < 400; ++row) {
    for (int column = 0; column < 400; ++column) {
      const bool lid =
          std::abs(static_cast<float>(row) + 0.5F - 200) < 50 && std::abs(static_cast<float>(column) + 0.5F - 200) < 50;
      depth_m->push_back(lid ? kTop_m - kLid_m : kTop_m);
    }
  }
  map.depth_m = {depth_m, reinterpret_cast<const std::byte*>(depth_m->data())};
  return {.maps = {map}};
}

TEST(ShadowMask, WhatLiesUnderTheLidIsInShadow) {
  const Camera camera = look_at({2, 2, 3}, {0, 0, 0}, 60, 48, 1);
  // Depth of the floor alone, from the ray's own slope.
  cv::Mat depth(48, 60, CV_32FC1);
  const glm::vec3 eye = camera.world_from_camera.translation;
  for (int row = 0; row < depth.rows; ++row) {
    for (int column = 0; column < depth.cols; ++column) {
      const glm::vec3 ray =
          camera.world_from_camera.rotation * glm::vec3((static_cast<float>(column) + 0.5F - camera.cx) / camera.fx,
                                                        (static_cast<float>(row) + 0.5F - camera.cy) / camera.fy, 1);
      depth.at<float>(row, column) = ray.y < 0 ? -eye.y / ray.y : 0;
    }
  }
  const cv::Mat lit = lit_surfaces(depth, camera, sun_above());
  int shadowed = 0;
  for (int row = 0; row < depth.rows; ++row) {
    for (int column = 0; column < depth.cols; ++column) {
      const glm::vec3 ray =
          camera.world_from_camera.rotation * glm::vec3((static_cast<float>(column) + 0.5F - camera.cx) / camera.fx,
                                                        (static_cast<float>(row) + 0.5F - camera.cy) / camera.fy, 1);
      const bool lit_here = lit.at<std::uint8_t>(row, column) != 0;
      if (ray.y >= 0) {
        EXPECT_TRUE(lit_here) << "no surface";
        continue;
      }
      const glm::vec3 point = eye + ray * (-eye.y / ray.y);
      const float reach = std::max(std::abs(point.x), std::abs(point.z));
      if (reach < 0.48F) {
        EXPECT_FALSE(lit_here) << point.x << ", " << point.z;
      }
      if (reach > 0.52F) {
        EXPECT_TRUE(lit_here) << point.x << ", " << point.z;
      }
      shadowed += lit_here ? 0 : 1;
    }
  }
  EXPECT_GT(shadowed, 50);
}

TEST(ShadowMask, OnlyEdgesThatMovedCount) {
  cv::Mat before(60, 80, CV_8UC1, cv::Scalar(255));
  before(cv::Rect(30, 20, 20, 20)).setTo(0);
  cv::Mat now(60, 80, CV_8UC1, cv::Scalar(255));
  now(cv::Rect(34, 20, 20, 20)).setTo(0);
  now.at<std::uint8_t>(50, 10) = 0;  // one pixel is noise
  cv::Mat occupied = cv::Mat::zeros(60, 80, CV_8UC1);
  occupied(cv::Rect(26, 16, 10, 30)).setTo(255);  // the left edge is hidden by what moves
  const cv::Mat mask = moving_shadow_edges(before, now, occupied, 3);
  EXPECT_NE(mask.at<std::uint8_t>(30, 52), 0) << "the right edge, swept from 50 to 54";
  EXPECT_NE(mask.at<std::uint8_t>(30, 47), 0) << "3 pixels beside it";
  EXPECT_EQ(mask.at<std::uint8_t>(30, 46), 0);
  EXPECT_NE(mask.at<std::uint8_t>(30, 56), 0);
  EXPECT_EQ(mask.at<std::uint8_t>(30, 57), 0);
  EXPECT_EQ(mask.at<std::uint8_t>(30, 32), 0) << "occupied";
  EXPECT_EQ(mask.at<std::uint8_t>(50, 10), 0) << "noise";
  EXPECT_EQ(cv::countNonZero(moving_shadow_edges(now, now, occupied, 3)), 0);
}

}  // namespace
}  // namespace splatbus::cli
