#include "relight/filter.h"

#include <array>
#include <cmath>
#include <cstddef>
#include <limits>

// Highway needs this order.
// clang-format off
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "relight/filter.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"
// clang-format on

HWY_BEFORE_NAMESPACE();
namespace splatbus::relight::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using F = hn::ScalableTag<float>;
using V = hn::Vec<F>;

struct Map {
  const float* depth_m;
  int width, height;
};

/// Depths of texels x, x + 1, ... of a row; what lies outside of the map is behind everything.
HWY_INLINE V LoadDepths(const Map& map, int x, int y) {
  const F f;
  const int lanes = static_cast<int>(hn::Lanes(f));
  const bool row_inside = y >= 0 && y < map.height;
  const float* row = map.depth_m + static_cast<std::ptrdiff_t>(y) * map.width;
  if (row_inside && x >= 0 && x + lanes <= map.width) return hn::LoadU(f, row + x);
  HWY_ALIGN std::array<float, hn::MaxLanes(F())> depths;
  for (int k = 0; k < lanes; ++k) {
    const bool inside = row_inside && x + k >= 0 && x + k < map.width;
    depths[static_cast<std::size_t>(k)] = inside ? row[x + k] : std::numeric_limits<float>::max();
  }
  return hn::Load(f, depths.data());
}

float LitShare(const FilterWindow& w, const float* depth_m, int width, int height) {
  const F f;
  const Map map{depth_m, width, height};
  const auto lanes = static_cast<int>(hn::Lanes(f));
  const V lane = hn::Iota(f, 0.0F), one_step = hn::Set(f, 1.0F / w.radius_x), slope = hn::Set(f, w.slope_x);
  V lit = hn::Zero(f), weight = hn::Zero(f);
  const int bottom = static_cast<int>(std::ceil(w.y + w.radius_y));
  for (int y = static_cast<int>(std::floor(w.y - w.radius_y)); y < bottom; ++y) {
    const float dy = static_cast<float>(y) + 0.5F - w.y;
    const float row_weight = 1.0F - dy * dy / (w.radius_y * w.radius_y);
    if (row_weight <= 0.0F) continue;
    const float half = w.radius_x * std::sqrt(row_weight);
    const int right = static_cast<int>(std::ceil(w.x + half));
    const V most = hn::Set(f, row_weight);
    for (int x = static_cast<int>(std::floor(w.x - half)); x < right; x += lanes) {
      const float dx = static_cast<float>(x) + 0.5F - w.x;
      const V across = hn::MulAdd(lane, one_step, hn::Set(f, dx / w.radius_x));
      const V share = hn::Max(hn::NegMulAdd(across, across, most), hn::Zero(f));
      const V plane_m = hn::MulAdd(lane, slope, hn::Set(f, w.depth_m + w.slope_y * dy + w.slope_x * dx));
      weight = hn::Add(weight, share);
      lit = hn::Add(lit, hn::IfThenElseZero(hn::Le(plane_m, LoadDepths(map, x, y)), share));
    }
  }
  const float all = hn::GetLane(hn::SumOfLanes(f, weight)), reached = hn::GetLane(hn::SumOfLanes(f, lit));
  return reached < all ? reached / all : 1.0F;
}

}  // namespace splatbus::relight::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace splatbus::relight {
HWY_EXPORT(LitShare);
float lit_share_on_host(const FilterWindow& window, const float* depth_m, int width, int height) {
  return HWY_DYNAMIC_DISPATCH(LitShare)(window, depth_m, width, height);
}
}  // namespace splatbus::relight
#endif
