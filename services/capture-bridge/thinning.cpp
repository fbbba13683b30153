#include "capture-bridge/thinning.h"

#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>

namespace splatbus::capture_bridge {

namespace {

constexpr float kMortonCells = 2097151.0F;  // 21 bits an axis

std::uint64_t spread_bits(std::uint64_t v) {
  v &= 0x1fffff;
  v = (v | v << 32) & 0x1f00000000ffff;
  v = (v | v << 16) & 0x1f0000ff0000ff;
  v = (v | v << 8) & 0x100f00f00f00f00f;
  v = (v | v << 4) & 0x10c30c30c30c30c3;
  v = (v | v << 2) & 0x1249249249249249;
  return v;
}

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
  const glm::vec3 size = high - low;
  const float scale = kMortonCells / std::max({size.x, size.y, size.z, 1e-6F});
  std::vector<Keyed> order(position.size());
  tbb::parallel_for(std::size_t{0}, position.size(), [&](std::size_t i) {
    const glm::vec3 cell = (position[i] - low) * scale;
    order[i] = {.morton = spread_bits(static_cast<std::uint64_t>(cell.x)) |
                          spread_bits(static_cast<std::uint64_t>(cell.y)) << 1U |
                          spread_bits(static_cast<std::uint64_t>(cell.z)) << 2U,
                .index = static_cast<std::uint32_t>(i)};
  });
  tbb::parallel_sort(order.begin(), order.end());
  return order;
}

/// T with sum_i min(1, area_i / T) = budget.
double area_per_point(std::span<const float> area_m2, std::size_t budget) {
  std::vector<float> sorted(area_m2.begin(), area_m2.end());
  tbb::parallel_sort(sorted.begin(), sorted.end());
  double below = 0;
  for (const float area : sorted) below += area;
  // Points larger than T are kept for sure; take them off the top until the rest fits what is left of the budget.
  std::size_t certain = 0;
  double threshold = below / static_cast<double>(budget);
  while (certain + 1 < budget && sorted[sorted.size() - 1 - certain] > threshold) {
    below -= sorted[sorted.size() - 1 - certain];
    ++certain;
    threshold = below / static_cast<double>(budget - certain);
  }
  return threshold;
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
  const double threshold = area_per_point(area_m2, budget);
  double sum = 0.5;
  for (const Keyed& keyed : order) {
    const double before = std::floor(sum);
    sum += std::min(1.0, area_m2[keyed.index] / threshold);
    if (std::floor(sum) > before && kept.size() < budget) kept.push_back(keyed.index);
  }
  return kept;
}

}  // namespace splatbus::capture_bridge
