#include "shadow_mask.h"

#include <cassert>
#include <cmath>
#include <cstdint>
#include <opencv2/imgproc.hpp>

#include "dynamics_figures.h"

namespace splatbus::cli {

namespace {

constexpr float kBias_m = 0.03F;  ///< of the compared depths: several texels' slope

/// By the finest map that has it; outside of all of them all is lit.
bool sees_the_sun(const glm::vec3& point_world, const relight::LightMaps& sun) {
  for (const relight::LightMaps::Map& map : sun.maps) {
    const glm::vec3 seen = project(map.camera, point_world);
    const auto column = static_cast<std::int64_t>(std::floor(seen.x)),
               row = static_cast<std::int64_t>(std::floor(seen.y));
    if (column < 0 || row < 0 || column >= map.camera.width || row >= map.camera.height) continue;
    const auto* depth_m = reinterpret_cast<const float*>(map.depth_m.get());
    return seen.z <= depth_m[row * map.camera.width + column] + kBias_m;
  }
  return true;
}

}  // namespace

cv::Mat lit_surfaces(const cv::Mat& depth, const Camera& camera, const relight::LightMaps& sun) {
  assert(depth.type() == CV_32FC1);
  cv::Mat lit(depth.size(), CV_8UC1, cv::Scalar(255));
  for (int row = 0; row < depth.rows; ++row) {
    const auto* depths = depth.ptr<float>(row);
    auto* out = lit.ptr<std::uint8_t>(row);
    for (int column = 0; column < depth.cols; ++column) {
      if (depths[column] <= 0) continue;
      const glm::vec3 point =
          unproject(camera, static_cast<float>(column) + 0.5F, static_cast<float>(row) + 0.5F, depths[column]);
      if (!sees_the_sun(point, sun)) out[column] = 0;
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
