#include <thrust/find.h>
#include <thrust/functional.h>
#include <thrust/scan.h>
#include <thrust/sequence.h>
#include <thrust/sort.h>
#include <thrust/transform_reduce.h>
#include <thrust/transform_scan.h>

#include "capture-bridge/neighbour_tree.h"
#include "capture-bridge/stages.h"
#include "device/parallel.h"

namespace splatbus::capture_bridge {

namespace {

SPLATBUS_PORTABLE void store3(float* array, std::size_t i, const Vec3& v) {
  array[3 * i] = v.x;
  array[3 * i + 1] = v.y;
  array[3 * i + 2] = v.z;
}

struct BoxOf {
  const float* position;
  SPLATBUS_PORTABLE_MEMBER Box operator()(std::uint32_t i) const {
    const Vec3 p = load3(position, i);
    return {p, p};
  }
};

struct Unite {
  SPLATBUS_PORTABLE_MEMBER Box operator()(const Box& a, const Box& b) const { return united(a, b); }
};

SPLATBUS_PORTABLE std::uint64_t spread_bits(std::uint64_t v) {
  v = (v | v << 32) & 0x1f00000000ffff;
  v = (v | v << 16) & 0x1f0000ff0000ff;
  v = (v | v << 8) & 0x100f00f00f00f00f;
  v = (v | v << 4) & 0x10c30c30c30c30c3;
  v = (v | v << 2) & 0x1249249249249249;
  return v;
}

/// Codes of 21 bits an axis in the cube over `bounds`.
struct MortonCode {
  const float* position;
  Box bounds;
  std::uint64_t* code;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    constexpr float kLastCell = 2097151.0F;
    const Vec3 size = bounds.high - bounds.low;
    const float cells_per_metre = kLastCell / larger(larger(size.x, size.y), larger(size.z, 1e-6F));
    const Vec3 cell = (load3(position, i) - bounds.low) * cells_per_metre;
    // Sizes beyond floats' range make cells that are no number: 0.
    code[i] = spread_bits(static_cast<std::uint64_t>(clamped(cell.x, 0, kLastCell))) |
              spread_bits(static_cast<std::uint64_t>(clamped(cell.y, 0, kLastCell))) << 1U |
              spread_bits(static_cast<std::uint64_t>(clamped(cell.z, 0, kLastCell))) << 2U;
  }
};

/// Areas as fixed-point numbers of the largest one, and shares of a point, are summed as integers: the sums are the
/// same in any order. Of up to 2^30 points they fit 64 bits.
constexpr int kShareBits = 32;
constexpr double kOne = 4294967296.0;

struct FixedArea {
  double per_m2;
  SPLATBUS_PORTABLE_MEMBER std::uint64_t operator()(float area_m2) const {
    return static_cast<std::uint64_t>(static_cast<double>(area_m2) * per_m2 + 0.5);
  }
};

/// When the `certain` largest points are kept for sure, the others share what is left of the budget; `sums` are those
/// of the ascending areas.
struct AreaPerPoint {
  const std::uint64_t* sums;
  std::uint32_t count, budget;
  double per_m2;
  SPLATBUS_PORTABLE_MEMBER double operator()(std::uint32_t certain) const {
    return static_cast<double>(sums[count - 1 - certain]) / per_m2 / static_cast<double>(budget - certain);
  }
};

/// Whether more than `certain` points are larger than the others' area per point.
struct NextIsCertain {
  const float* ascending;
  AreaPerPoint area_per_point;
  SPLATBUS_PORTABLE_MEMBER bool operator()(std::uint32_t certain) const {
    return certain + 1 < area_per_point.budget &&
           ascending[area_per_point.count - 1 - certain] > area_per_point(certain);
  }
};

struct ShareOfBudget {
  const float* area_m2;
  const std::uint32_t* order;
  AreaPerPoint area_per_point;
  std::uint32_t certain;
  std::uint64_t* share;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const float part = area_m2[order[i]] / static_cast<float>(area_per_point(certain));
    share[i] = part < 1 ? static_cast<std::uint64_t>(part * static_cast<float>(kOne)) : std::uint64_t{1} << kShareBits;
  }
};

/// A point is kept when the sum of shares, which begins at one half, reaches a new whole number with it.
struct KeepPoint {
  const std::uint32_t* order;
  const std::uint64_t* share;
  const std::uint64_t* sum;
  std::uint32_t count, budget;
  std::uint32_t* kept;
  std::uint32_t* kept_count;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::uint64_t with = (std::uint64_t{1} << (kShareBits - 1)) + sum[i];
    const std::uint64_t before = (with - share[i]) >> kShareBits, after = with >> kShareBits;
    if (after > before && before < budget) kept[before] = order[i];
    if (i + 1 == count) *kept_count = static_cast<std::uint32_t>(after < budget ? after : budget);
  }
};

/// A pixel's linear colour without the background's share of it.
SPLATBUS_PORTABLE Vec3 without_background(const LinearTable& linear, const std::uint8_t* rgba, const Vec3& background) {
  // Below this a pixel is mostly background, and dividing by it amplifies noise.
  constexpr float kMinCoverage = 0.25F;
  const Vec3 blended{linear.value[rgba[0]], linear.value[rgba[1]], linear.value[rgba[2]]};
  const float coverage = static_cast<float>(rgba[3]) / 255.0F;
  if (rgba[3] == 255 || coverage < kMinCoverage) return blended;
  const Vec3 own = (blended - background * (1 - coverage)) * (1.0F / coverage);
  return {clamped(own.x, 0, 1), clamped(own.y, 0, 1), clamped(own.z, 0, 1)};
}

struct WriteSample {
  RoundPixels round;
  Candidates candidates;
  const std::uint32_t* kept;
  float spacing_growth;
  const LinearTable* linear;
  Samples samples;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t k) const {
    const std::uint32_t candidate = kept[k];
    const std::uint32_t pixel = candidates.pixel[candidate];
    const PixelView& view = round.views[pixel / round.view_pixels];
    const std::size_t in_view = pixel % round.view_pixels;
    const Surfel surfel = round.surfels[pixel];
    const MovedObject* moved = find_moved(view, surfel.object_id);
    store3(samples.position, k, load3(candidates.position, candidate));
    store3(samples.normal, k, moved == nullptr ? surfel.normal : moved->round_from_view.rotation * surfel.normal);
    store3(samples.color, k, without_background(*linear, view.color + 4 * in_view, view.background));
    const bool is_far = surfel.object_id == round.far_field.frame_id;  // what emits has the colour that is seen
    store3(samples.albedo, k,
           is_far ? load3(samples.color, k) : without_background(*linear, view.albedo + 4 * in_view, Vec3()));
    samples.spacing_m[k] = sqrtf(candidates.area_m2[candidate]) * spacing_growth;
    samples.object_id[k] = surfel.object_id;
    samples.pixel[k] = pixel;
  }
};

/// `order`: the points along the Morton curve.
void sort_along_curve(device::StreamView stream, const float* position, std::uint32_t count,
                      device::Buffer<std::uint32_t>& order) {
  device::Buffer<std::uint64_t> code(stream, count);
  order.resize(count);
  const thrust::counting_iterator<std::uint32_t> first(0);
  const Box bounds = device::with_policy(stream, [&](auto&& policy) {
    return thrust::transform_reduce(policy, first, first + count, BoxOf{position}, Box(), Unite());
  });
  device::for_each_index(stream, count, MortonCode{position, bounds, code.data()});
  device::with_policy(stream, [&](auto&& policy) {
    thrust::sequence(policy, order.data(), order.data() + count);
    thrust::stable_sort_by_key(policy, code.data(), code.data() + count, order.data());
  });
}

}  // namespace

std::uint32_t thin_to_budget(device::StreamView stream, const float* position, const float* area_m2,
                             std::uint32_t count, std::size_t budget, device::Buffer<std::uint32_t>& kept) {
  if (count == 0 || budget == 0) return 0;
  if (count <= budget) {
    sort_along_curve(stream, position, count, kept);
    return count;
  }
  device::Buffer<std::uint32_t> order(stream);
  sort_along_curve(stream, position, count, order);
  device::Buffer<float> ascending(stream);
  ascending.assign(area_m2, count);
  device::Buffer<std::uint64_t> area_sum(stream, count), share(stream, count), share_sum(stream, count);
  device::Buffer<std::uint32_t> kept_count(stream, 1);
  kept.resize(budget);
  float max_area_m2 = 0;
  device::with_policy(stream, [&](auto&& policy) { thrust::sort(policy, ascending.data(), ascending.data() + count); });
  device::copy(stream, &max_area_m2, ascending.data() + (count - 1), sizeof(float));
  stream.wait();
  const double per_m2 = kOne / static_cast<double>(max_area_m2);
  const AreaPerPoint area_per_point{area_sum.data(), count, static_cast<std::uint32_t>(budget), per_m2};
  device::with_policy(stream, [&](auto&& policy) {
    thrust::transform_inclusive_scan(policy, ascending.data(), ascending.data() + count, area_sum.data(),
                                     FixedArea{per_m2}, thrust::plus<std::uint64_t>());
  });
  const thrust::counting_iterator<std::uint32_t> first(0);
  const std::uint32_t certain = *device::with_policy(stream, [&](auto&& policy) {
    return thrust::find_if_not(policy, first, first + area_per_point.budget,
                               NextIsCertain{ascending.data(), area_per_point});
  });
  device::for_each_index(stream, count, ShareOfBudget{area_m2, order.data(), area_per_point, certain, share.data()});
  device::with_policy(stream, [&](auto&& policy) {
    thrust::inclusive_scan(policy, share.data(), share.data() + count, share_sum.data());
  });
  device::for_each_index(stream, count,
                         KeepPoint{order.data(), share.data(), share_sum.data(), count, area_per_point.budget,
                                   kept.data(), kept_count.data()});
  return kept_count.to_host().front();
}

void write_samples(device::StreamView stream, const RoundPixels& round, const Candidates& candidates,
                   const std::uint32_t* kept, float spacing_growth, const LinearTable* linear, const Samples& samples) {
  device::for_each_index(stream, samples.count, WriteSample{round, candidates, kept, spacing_growth, linear, samples});
}

}  // namespace splatbus::capture_bridge
