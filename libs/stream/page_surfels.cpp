#include "stream/page_surfels.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace splatbus::stream {

namespace {

constexpr std::int32_t kSolid = 128;  // of 255

/// Points scattered at random over a surface, n a square metre, are 1 / (2 sqrt(n)) from the nearest other one in the
/// mean (Clark and Evans 1954); those that keep apart from each other, as lanes along a curve do, are farther.
float radius_of(const std::vector<glm::vec3>& points) {
  if (points.size() < 2) return 0;
  float sum = 0;
  for (const glm::vec3& point : points) {
    float nearest = std::numeric_limits<float>::max();
    for (const glm::vec3& other : points) {
      if (&other != &point) nearest = std::min(nearest, glm::distance(point, other));
    }
    sum += nearest;
  }
  return 2 * std::numbers::inv_sqrtpi_v<float> * sum / static_cast<float>(points.size());
}

}  // namespace

PageSurfels surfels_of(const ReplicatedState& state, const HeldPage& page) {
  const AttributeChannels &mean = state.layout.at(Attribute::Mean), &opacity = state.layout.at(Attribute::Opacity);
  std::vector<std::uint32_t> solid;
  for (std::uint32_t lane = 0; lane < page.count; ++lane) {
    if (state.gaussians.channels[static_cast<std::size_t>(opacity.first)][page.row(lane)] >= kSolid) {
      solid.push_back(page.row(lane));
    }
  }
  PageSurfels surfels;
  const std::size_t count = std::min(solid.size(), PageSurfels::kMost);
  for (std::size_t k = 0; k < count; ++k) {
    glm::vec3 point;
    for (int c = 0; c < 3; ++c) {
      const std::int32_t value =
          state.gaussians.channels[static_cast<std::size_t>(mean.first + c)][solid[k * solid.size() / count]];
      point[c] = mean.quantizer.offset + mean.quantizer.step * static_cast<float>(value);
    }
    surfels.points_m.push_back(point);
  }
  surfels.radius_m = radius_of(surfels.points_m);
  return surfels;
}

}  // namespace splatbus::stream
