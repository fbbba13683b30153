#include "relight/filter.h"

#include <array>
#include <cmath>
#include <cstddef>

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

struct Texels {
  V depth_m, weight;  ///< 0 or 1: whether they lie in the map
};

/// Texels x, x + 1, ... of a row.
HWY_INLINE Texels LoadTexels(const Map& map, int x, int y) {
  const F f;
  const int lanes = static_cast<int>(hn::Lanes(f));
  if (y < 0 || y >= map.height) return {hn::Zero(f), hn::Zero(f)};
  const float* row = map.depth_m + static_cast<std::ptrdiff_t>(y) * map.width;
  if (x >= 0 && x + lanes <= map.width) return {hn::LoadU(f, row + x), hn::Set(f, 1.0F)};
  HWY_ALIGN std::array<float, hn::MaxLanes(F())> depths{}, weights{};
  for (int k = 0; k < lanes; ++k) {
    if (x + k < 0 || x + k >= map.width) continue;
    depths[static_cast<std::size_t>(k)] = row[x + k];
    weights[static_cast<std::size_t>(k)] = 1.0F;
  }
  return {hn::Load(f, depths.data()), hn::Load(f, weights.data())};
}

template <Projection kProjection>
HWY_INLINE float LitShare(const FilterWindow& w, const float* depth_m, int width, int height) {
  const F f;
  const Map map{depth_m, width, height};
  const auto lanes = static_cast<int>(hn::Lanes(f));
  const V lane = hn::Iota(f, 0.0F), one_step = hn::Set(f, 1.0F / w.radius_x), slope = hn::Set(f, w.slope_x);
  V hidden = hn::Zero(f), weight = hn::Zero(f);
  const float per_row = 1.0F / (w.radius_y * w.radius_y);
  const int left = static_cast<int>(std::floor(w.x - w.radius_x));
  const int right = static_cast<int>(std::ceil(w.x + w.radius_x));
  const bool wide = right - left > lanes;  // else one vector has a whole row, and its ends are left to the weights
  const int bottom = static_cast<int>(std::ceil(w.y + w.radius_y));
  for (int y = static_cast<int>(std::floor(w.y - w.radius_y)); y < bottom; ++y) {
    const float dy = static_cast<float>(y) + 0.5F - w.y;
    const float row_weight = 1.0F - dy * dy * per_row;
    if (row_weight <= 0.0F) continue;
    const float half = wide ? w.radius_x * std::sqrt(row_weight) : w.radius_x;
    const int end = wide ? static_cast<int>(std::ceil(w.x + half)) : right;
    const V most = hn::Set(f, row_weight);
    for (int x = wide ? static_cast<int>(std::floor(w.x - half)) : left; x < end; x += lanes) {
      const float dx = static_cast<float>(x) + 0.5F - w.x;
      const V across = hn::Mul(hn::Add(lane, hn::Set(f, dx)), one_step);
      V share = hn::Max(hn::NegMulAdd(across, across, most), hn::Zero(f));
      const V plane = hn::MulAdd(lane, slope, hn::Set(f, w.plane + w.slope_y * dy + w.slope_x * dx));
      const Texels texels = LoadTexels(map, x, y);
      const V inside = hn::Mul(share, texels.weight);
      if constexpr (kProjection == Projection::Pinhole) {
        weight = hn::Add(weight, inside);
        const auto lit = hn::Ge(hn::Mul(plane, texels.depth_m), hn::Set(f, 1.0F));
        hidden = hn::Add(hidden, hn::IfThenZeroElse(lit, inside));
      } else {
        weight = hn::Add(weight, share);
        hidden = hn::Add(hidden, hn::IfThenZeroElse(hn::Le(plane, texels.depth_m), inside));
      }
    }
  }
  const float shade = hn::GetLane(hn::SumOfLanes(f, hidden));
  if (!(shade > 0.0F)) return 1.0F;
  const float all = hn::GetLane(hn::SumOfLanes(f, weight));
  return shade < all ? (all - shade) / all : 0.0F;
}

float OrthographicShare(const FilterWindow& w, const float* depth_m, int width, int height) {
  return LitShare<Projection::Orthographic>(w, depth_m, width, height);
}
float PinholeShare(const FilterWindow& w, const float* depth_m, int width, int height) {
  return LitShare<Projection::Pinhole>(w, depth_m, width, height);
}

}  // namespace splatbus::relight::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace splatbus::relight {
HWY_EXPORT(OrthographicShare);
HWY_EXPORT(PinholeShare);
float lit_share_on_host(Projection projection, const FilterWindow& w, const float* depth_m, int width, int height) {
  return projection == Projection::Pinhole ? HWY_DYNAMIC_DISPATCH(PinholeShare)(w, depth_m, width, height)
                                           : HWY_DYNAMIC_DISPATCH(OrthographicShare)(w, depth_m, width, height);
}
}  // namespace splatbus::relight
#endif
