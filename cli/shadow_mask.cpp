#include "shadow_mask.h"

#include <cassert>
#include <cmath>
#include <cstdint>
#include <opencv2/imgproc.hpp>

#include "dynamics_figures.h"

namespace splatbus::cli {

namespace {

constexpr float kBias_m = 0.03F;  ///< of the compared depths: several texels' slope

bool sees_the_sun(const glm::vec3& point_world, const LightDepths::Map& map) {
  const glm::vec3 seen = project(map.camera, point_world);
  const auto column = static_cast<std::int64_t>(std::floor(seen.x)),
             row = static_cast<std::int64_t>(std::floor(seen.y));
  if (column < 0 || row < 0 || column >= map.camera.width || row >= map.camera.height) return true;
  return seen.z <=
         map.depth_m[static_cast<std::size_t>(row) * map.camera.width + static_cast<std::size_t>(column)] + kBias_m;
}

}  // namespace

cv::Mat lit_surfaces(const cv::Mat& depth, const Camera& camera, const LightDepths::Map& map) {
  assert(depth.type() == CV_32FC1);
  cv::Mat lit(depth.size(), CV_8UC1, cv::Scalar(255));
  for (int row = 0; row < depth.rows; ++row) {
    const auto* depths = depth.ptr<float>(row);
    auto* out = lit.ptr<std::uint8_t>(row);
    for (int column = 0; column < depth.cols; ++column) {
      if (depths[column] <= 0) continue;
      const glm::vec3 point =
          unproject(camera, static_cast<float>(column) + 0.5F, static_cast<float>(row) + 0.5F, depths[column]);
      if (!sees_the_sun(point, map)) out[column] = 0;
    }
  }
  return lit;
}

cv::Mat moving_shadow_edges(const cv::Mat& lit_before, const cv::Mat& lit_now, const cv::Mat& occupied, int reach) {
  cv::Mat changed = lit_before ^ lit_now;
  changed.setTo(0, occupied);
  cv::medianBlur(changed, changed, 3);
  return grown(changed, reach);
}

}  // namespace splatbus::cli
