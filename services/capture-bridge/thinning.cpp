#include "capture-bridge/thinning.h"

#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <functional>
#include <limits>
#include <numeric>

#include "capture-bridge/thinning_math.h"

namespace splatbus::capture_bridge {

namespace {

struct Keyed {
  std::uint64_t morton;
  std::uint32_t index;
  bool operator<(const Keyed& other) const {
    return morton != other.morton ? morton < other.morton : index < other.index;
  }
};

std::vector<Keyed> morton_order(std::span<const glm::vec3> position) {
  glm::vec3 low(std::numeric_limits<float>::max());
  glm::vec3 high(std::numeric_limits<float>::lowest());
  for (const glm::vec3& p : position) {
    low = glm::min(low, p);
    high = glm::max(high, p);
  }
  const MortonCube cube = morton_cube({low.x, low.y, low.z}, {high.x, high.y, high.z});
  std::vector<Keyed> order(position.size());
  tbb::parallel_for(std::size_t{0}, position.size(), [&](std::size_t i) {
    order[i] = {.morton = morton_code(cube, {position[i].x, position[i].y, position[i].z}),
                .index = static_cast<std::uint32_t>(i)};
  });
  tbb::parallel_sort(order.begin(), order.end());
  return order;
}

/// T with sum_i min(1, area_i / T) = budget.
float threshold_of(std::span<const float> area_m2, std::size_t budget) {
  std::vector<float> sorted(area_m2.begin(), area_m2.end());
  tbb::parallel_sort(sorted.begin(), sorted.end());
  std::vector<double> sum_m2(sorted.size());
  std::inclusive_scan(sorted.begin(), sorted.end(), sum_m2.begin(), std::plus<>(), 0.0);
  // Points larger than T are kept for sure; take them off the top until the rest fits what is left of the budget.
  std::size_t certain = 0;
  double threshold = area_per_point(sum_m2.back(), 0, budget);
  while (certain + 1 < budget && sorted[sorted.size() - 1 - certain] > threshold) {
    ++certain;
    threshold = area_per_point(sum_m2[sorted.size() - 1 - certain], certain, budget);
  }
  return static_cast<float>(threshold);
}

}  // namespace

std::vector<std::uint32_t> thin_to_budget(std::span<const glm::vec3> position, std::span<const float> area_m2,
                                          std::size_t budget) {
  assert(position.size() == area_m2.size());
  std::vector<std::uint32_t> kept;
  if (position.empty() || budget == 0) return kept;
  const std::vector<Keyed> order = morton_order(position);
  kept.reserve(std::min(budget, order.size()));
  if (order.size() <= budget) {
    for (const Keyed& keyed : order) kept.push_back(keyed.index);
    return kept;
  }
  const float threshold = threshold_of(area_m2, budget);
  std::uint64_t sum = kFirstShare;
  for (const Keyed& keyed : order) {
    const std::uint64_t before = sum >> kShareBits;
    sum += share_of(area_m2[keyed.index], threshold);
    if (sum >> kShareBits > before && kept.size() < budget) kept.push_back(keyed.index);
  }
  return kept;
}

}  // namespace splatbus::capture_bridge
