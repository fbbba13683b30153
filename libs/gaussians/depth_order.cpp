#include "gaussians/depth_order.h"

#include <algorithm>
#include <cmath>

namespace splatbus {

namespace {

constexpr std::uint32_t kKeys = 1 << 16;
constexpr float kInfinity = INFINITY;

}  // namespace

void DepthOrder::resize(std::size_t rows) {
  places_.resize(rows);
}

void DepthOrder::set_transforms(std::span<const Transform> transforms, std::uint32_t far_field) {
  transforms_.assign(transforms.begin(), transforms.end());
  far_field_ = far_field;
}

std::span<const std::uint32_t> DepthOrder::sort(const std::array<float, 4>& view_z, float near_m) {
  const glm::vec3 z(view_z[0], view_z[1], view_z[2]);
  planes_.clear();
  for (std::size_t k = 0; k < transforms_.size(); ++k) {
    const Transform& t = transforms_[k];
    const glm::vec3 normal(z.x * t[0] + z.y * t[4] + z.z * t[8], z.x * t[1] + z.y * t[5] + z.z * t[9],
                           z.x * t[2] + z.y * t[6] + z.z * t[10]);
    const float place = z.x * t[3] + z.y * t[7] + z.z * t[11];
    const bool hidden = std::all_of(t.begin(), t.end(), [](float value) { return value == 0; });
    const bool far = far_field_ != 0 && k == far_field_;
    planes_.push_back({normal, hidden ? -kInfinity : far ? place : place + view_z[3]});
  }
  // Bits of positive floats are in the order of their values.
  keys_.resize(places_.size());
  std::uint32_t low = 0xFFFFFFFFU, high = 0;
  for (std::size_t row = 0; row < places_.size(); ++row) {
    const Place& place = places_[row];
    std::uint32_t bits = 0;
    if (place.object < planes_.size()) {
      const Plane& plane = planes_[place.object];
      const float depth =
          plane.normal.x * place.mean.x + plane.normal.y * place.mean.y + plane.normal.z * place.mean.z + plane.offset;
      if (depth > near_m && depth < kInfinity) {
        bits = glm::floatBitsToUint(depth);
        low = std::min(low, bits);
        high = std::max(high, bits);
      }
    }
    keys_[row] = bits;
  }
  order_.clear();
  if (high == 0) return order_;
  int shift = 0;
  while (((high - low) >> shift) >= kKeys) ++shift;
  const std::uint32_t last = (high - low) >> shift;
  counts_.assign(last + 2, 0);
  for (std::uint32_t& key : keys_) {
    if (key == 0) {
      key = kHidden;
      continue;
    }
    key = last - ((key - low) >> shift);
    ++counts_[key + 1];
  }
  for (std::size_t k = 1; k < counts_.size(); ++k) counts_[k] += counts_[k - 1];
  order_.resize(counts_.back());
  for (std::size_t row = 0; row < keys_.size(); ++row) {
    if (keys_[row] != kHidden) order_[counts_[keys_[row]]++] = static_cast<std::uint32_t>(row);
  }
  return order_;
}

}  // namespace splatbus
