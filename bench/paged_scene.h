#pragma once

#include <vector>

#include "device/large_pages.h"
#include "gaussians/model.h"

namespace splatbus::bench {

/// Gaussians in pages along a Morton curve, three quarters full, as after some splits: world frame.
class PagedScene {
 public:
  PagedScene() = default;
  explicit PagedScene(const GaussiansView& planar);

  [[nodiscard]] GaussiansView view(bool with_bounds) const;
  [[nodiscard]] float* parameters() { return memory_.data(); }

 private:
  ParameterLayout layout_;
  std::size_t page_floats_ = 0;
  std::vector<float, device::LargePageAllocator<float>>
      memory_;  // [pages][channels + 4][kRowWords]: parameters, normal, visibility
  std::vector<IndexRange> ranges_;
  std::vector<PageBounds> bounds_;
};

/// So many copies of a scene above one another, so far apart that the cameras see the first alone.
[[nodiscard]] GaussiansBuffer stacked(const GaussiansBuffer& scene, const std::vector<Camera>& cameras, int copies);

}  // namespace splatbus::bench
