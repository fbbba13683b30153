#include <thrust/copy.h>
#include <thrust/iterator/counting_iterator.h>
#include <thrust/sequence.h>
#include <thrust/sort.h>

#include <algorithm>

#include "expander/cell_search.h"
#include "expander/filled_cells.h"
#include "expander/local_sample.h"
#include "expander/point_grid.h"

namespace splatbus::expander {

using device::Buffer;
using device::for_each_index;
using device::StreamView;
using device::with_policy;
using math::Vec3;

namespace {

constexpr std::uint32_t kNeighbours = 27;
/// Edge of a search cell, of the spacing of the samples in it, at least: fewer samples a cell find the neighbours'
/// points more often, more samples look at more points each.
constexpr float kCellSpacings = 3;
constexpr float kFixedOne = 1 << 12;  // sums of integers are the same in any order

struct IsSet {
  SPLATBUS_PORTABLE_MEMBER bool operator()(std::uint8_t flag) const { return flag != 0; }
};

SPLATBUS_PORTABLE float distance_to_path(const Vec3& point, const Viewpoint& viewpoint) {
  const Vec3 path = viewpoint.ahead - viewpoint.position, to = point - viewpoint.position;
  const float squared = dot(path, path);
  const float along = squared > 0 ? math::clamped(dot(to, path) / squared, 0, 1) : 0;
  return length(to - path * along);
}

struct BinSample {
  Samples samples;
  ObjectFrames frames;
  const Viewpoint* viewpoints;
  std::uint32_t viewpoint_count;
  float reach_m, min_pixels;
  std::uint32_t far_field;  ///< the frame that goes with every viewer
  float cell_size_m, search_factor;
  CellKey *keys, *report_keys;
  std::uint32_t* beyond;

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER bool pays(std::uint32_t i) const {
    if (samples.object_id[i] == far_field) return true;
    for (std::uint32_t v = 0; v < viewpoint_count; ++v) {
      const float distance_m = distance_to_path(samples.position[i], viewpoints[v]);
      if (!(distance_m > reach_m)) return true;
      if (samples.spacing_m[i] * viewpoints[v].focal_px >= min_pixels * distance_m) return true;
    }
    return viewpoint_count == 0;
  }

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    keys[i] = report_keys[i] = {};
    if (samples.spacing_m[i] == 0 || !pays(i)) return;
    const LocalSample local = localised(samples, frames, i);
    const CellKey finest = cell_at(local.position_m(), local.frame_id, cell_size_m, 0);
    if (finest.none()) {
      device::atomic_add(beyond, 1U);
      return;
    }
    keys[i] = parent_of(finest, level_of(search_factor * local.spacing_m, cell_size_m));
    report_keys[i] = parent_of(finest, kReportLevel);
  }
};

struct Cells {
  const CellKey* keys;         ///< ascending
  const std::uint32_t* start;  ///< [count + 1], of their samples
  std::uint32_t count;

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER std::uint32_t samples(const CellKey& key) const {
    const std::uint32_t cell = lower_bound(keys, count, key);
    return cell < count && keys[cell] == key ? start[cell + 1] - start[cell] : 0;
  }
  /// Of the cells of a lower level in one.
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER std::uint32_t samples_in(const CellKey& key, unsigned level) const {
    const std::uint32_t first = lower_bound(keys, count, first_in(key, level));
    return start[first + near_lower_bound(keys + first, count - first, first_in(next_of(key), level))] - start[first];
  }
};

/// Offset of neighbour 0 to 26 along an axis.
SPLATBUS_PORTABLE int offset_of(std::uint32_t neighbour_index, std::uint32_t divisor) {
  return static_cast<int>(neighbour_index / divisor % 3) - 1;
}
SPLATBUS_PORTABLE CellKey neighbour_of(const CellKey& key, std::uint32_t k) {
  return neighbour(key, offset_of(k, 9), offset_of(k, 3), offset_of(k, 1));
}

/// For each cell of the round whether it is seen, and where the points of its neighbours lie.
struct TestCell {
  Cells cells;
  const CellKey* modelled;
  std::uint32_t modelled_count;
  std::uint32_t min_samples;
  bool* seen;
  std::uint32_t* neighbours;  ///< [cells][27][2]: first modelled point, one behind the last

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t cell) const {
    const CellKey key = cells.keys[cell];
    // What lies alone is no surface. Neighbours on one may be of a spacing that has cells of the next size.
    std::uint32_t about = key.level + 1 < kLevels ? cells.samples(parent_of(key, key.level + 1)) : 0;
    for (std::uint32_t k = 0; k < kNeighbours; ++k) {
      const CellKey at = neighbour_of(key, k);
      std::uint32_t* const range = neighbours + 2 * (std::size_t{cell} * kNeighbours + k);
      range[0] = range[1] = 0;
      if (at.none()) continue;
      about += cells.samples(at) + (at.level > 0 ? cells.samples_in(at, at.level - 1) : 0);
      range[0] = lower_bound(modelled, modelled_count, first_in(at, 0));
      range[1] = range[0] + near_lower_bound(modelled + range[0], modelled_count - range[0], first_in(next_of(at), 0));
    }
    seen[cell] = about >= min_samples;
  }
};

/// Ascending by the distance to what is modelled; bare is what has nothing within the edge of a search cell.
enum Lack : std::uint8_t { kCovered, kGap, kLoose, kHole, kBare };

/// For each candidate, in the order of the cells, how far it is from what is modelled.
struct TestSample {
  Samples samples;
  ObjectFrames frames;
  Cells cells;
  float cell_size_m;
  float fill_distance, new_distance, hole_distance;
  const CellKey* keys;
  const std::uint32_t* order;
  const ModelledPoint* points;
  const bool* seen;
  const std::uint32_t* neighbours;
  std::uint8_t* lack;  ///< a Lack
  CellSums* sums;

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER Lack lack_of(std::uint32_t cell, const LocalSample& local) const {
    const Vec3 position_m = local.position_m();
    const float edge_m = edge_of(cells.keys[cell].level, cell_size_m);
    const float new_m = new_distance * local.spacing_m,
                fill_m = math::smaller(fill_distance, new_distance) * local.spacing_m;
    const float reach_m = math::smaller(math::larger(hole_distance * local.spacing_m, new_m), edge_m);
    // Which neighbours the sphere about the position reaches into.
    const Vec3 within = position_m - cell_centre(cells.keys[cell], cell_size_m);
    const float inner = 0.5F * edge_m - reach_m;
    const auto reaches = [&](float along, int side) {
      return side == 0 || (side < 0 ? along < -inner : along > inner);
    };
    Lack lack = kBare;
    for (std::uint32_t i = 0; i < kNeighbours; ++i) {
      const std::uint32_t k = (i + kNeighbours / 2) % kNeighbours;  // the own cell first
      if (!reaches(within.x, offset_of(k, 9)) || !reaches(within.y, offset_of(k, 3)) ||
          !reaches(within.z, offset_of(k, 1))) {
        continue;
      }
      const std::uint32_t* const range = neighbours + 2 * (std::size_t{cell} * kNeighbours + k);
      for (std::uint32_t p = range[0]; p < range[1]; ++p) {
        const Vec3 apart = points[p].position - position_m;
        const float squared = dot(apart, apart);
        if (!(squared < reach_m * reach_m)) continue;
        if (!(dot(points[p].normal, local.normal) > kSameSurfaceCosine)) continue;
        if (squared < fill_m * fill_m) return kCovered;
        const Lack here = squared < new_m * new_m ? kGap : kLoose;
        lack = here < lack ? here : lack;
      }
    }
    return lack == kBare && is_near(cell, local.normal, position_m, edge_m) ? kHole : lack;
  }

  /// Whether anything modelled faces the same way within that distance, which is no longer than the cell's edge.
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER bool is_near(std::uint32_t cell, const Vec3& normal, const Vec3& position_m,
                                                      float distance_m) const {
    for (std::uint32_t k = 0; k < kNeighbours; ++k) {
      const std::uint32_t* const range = neighbours + 2 * (std::size_t{cell} * kNeighbours + k);
      for (std::uint32_t p = range[0]; p < range[1]; ++p) {
        const Vec3 apart = points[p].position - position_m;
        if (dot(apart, apart) < distance_m * distance_m && dot(points[p].normal, normal) > kSameSurfaceCosine)
          return true;
      }
    }
    return false;
  }

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::uint32_t cell = lower_bound(cells.keys, cells.count, keys[i]);
    lack[i] = seen[cell] ? lack_of(cell, localised(samples, frames, order[i])) : kCovered;
    if (lack[i] >= kLoose) device::atomic_add(&sums[cell].uncovered, 1U);
    if (lack[i] >= kHole) device::atomic_add(&sums[cell].holes, 1U);
    const float edge_m = edge_of(cells.keys[cell].level, cell_size_m);
    device::atomic_add(&sums[cell].spacing,
                       static_cast<std::uint32_t>(samples.spacing_m[order[i]] / edge_m * kFixedOne + 0.5F));
  }
};

struct WantSample {
  Cells cells;
  const CellKey* keys;
  const std::uint32_t* order;
  const std::uint8_t* lack;
  const std::uint8_t* fill;  ///< [cells]
  std::uint8_t* wanted;      ///< [samples of the round], in its order
  InsertReasons* reasons;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::uint32_t cell = lower_bound(cells.keys, cells.count, keys[i]);
    const bool is_wanted = lack[i] >= kHole || (lack[i] != kCovered && fill[cell] != 0);
    wanted[order[i]] = is_wanted ? 1 : 0;
    if (!is_wanted) return;
    std::uint32_t* const reason = lack[i] == kBare   ? &reasons->bare
                                  : lack[i] == kHole ? &reasons->hole
                                                     : &reasons->fill;
    device::atomic_add(reason, 1U);
  }
};

}  // namespace

SampleSelector::SampleSelector(StreamView stream, float cell_size_m)
    : stream_(stream),
      cell_size_m_(cell_size_m),
      objects_(stream),
      viewpoints_(stream),
      keys_(stream),
      cell_keys_(stream),
      order_(stream),
      cell_start_(stream),
      selected_(stream),
      counter_(stream, 1),
      sums_(stream),
      fill_(stream),
      wanted_(stream),
      lack_(stream),
      seen_(stream),
      neighbours_(stream) {}

void SampleSelector::bin(const Samples& samples, std::span<const ObjectFrame> objects,
                         std::span<const Viewpoint> viewpoints, const SelectOptions& options) {
  const std::uint32_t n = samples.count;
  binned_ = cells_ = beyond_ = 0;
  report_.clear();
  search_cells_.clear();
  if (n == 0) return;
  objects_.assign(objects);
  viewpoints_.assign(viewpoints);
  for (auto* buffer : {&keys_, &cell_keys_}) reserve(*buffer, n);
  for (auto* buffer : {&order_, &selected_}) reserve(*buffer, n);
  for (auto* buffer : {&wanted_, &lack_}) reserve(*buffer, n);
  reserve(cell_start_, std::size_t{n} + 1);
  counter_.clear();
  const float search_factor = std::max({kCellSpacings, options.new_distance, options.hole_distance});
  for_each_index(stream_, n,
                 BinSample{samples, frames(), viewpoints_.data(), static_cast<std::uint32_t>(viewpoints.size()),
                           options.reach_m, options.min_pixels, kFarFieldFrame, cell_size_m_, search_factor,
                           keys_.data(), cell_keys_.data(), counter_.data()});
  report_ = count_cells(stream_, cell_keys_.data(), n);
  beyond_ = counter_.to_host().front();
  with_policy(stream_, [&](auto&& policy) {
    thrust::sequence(policy, order_.data(), order_.data() + n);
    thrust::sort_by_key(policy, keys_.data(), keys_.data() + n, order_.data(), KeyBelow());
  });
  binned_ = named_count(stream_, keys_.data(), n);
  cells_ = list_cells(stream_, keys_.data(), binned_, cell_keys_.data(), cell_start_.data());
  device::copy(stream_, cell_start_.data() + cells_, &binned_, sizeof(binned_));
  search_cells_ = counts_of(stream_, cell_keys_.data(), cell_start_.data(), cells_, binned_);
}

std::uint32_t SampleSelector::select(const Samples& samples, const PointGrid& modelled, FilledCells& filled,
                                     const SelectOptions& options) {
  reasons_ = {};
  if (binned_ == 0) return 0;
  reserve(seen_, cells_);
  reserve(neighbours_, std::size_t{2} * kNeighbours * cells_);
  sums_.resize(cells_);
  sums_.clear();
  device::fill(stream_, wanted_.data(), 0, samples.count);
  const Cells cells{cell_keys_.data(), cell_start_.data(), cells_};
  for_each_index(
      stream_, cells_,
      TestCell{cells, modelled.keys(), modelled.size(), options.min_samples, seen_.data(), neighbours_.data()});
  for_each_index(stream_, binned_,
                 TestSample{samples, frames(), cells, cell_size_m_, options.fill_distance, options.new_distance,
                            options.hole_distance, keys_.data(), order_.data(), modelled.points(), seen_.data(),
                            neighbours_.data(), lack_.data(), sums_.data()});
  const std::vector<CellSums> sums = sums_.to_host();
  const std::vector<bool> holes = about_holes(sums);
  std::vector<std::uint8_t> fill(cells_);
  for (std::uint32_t c = 0; c < cells_; ++c) {
    const CellCount& cell = search_cells_[c];
    const auto count = static_cast<float>(cell.count);
    const float spacing_m =
        static_cast<float>(sums[c].spacing) / kFixedOne / count * edge_of(cell.key.level, cell_size_m_);
    const bool lacks = holes[c] || (sums[c].uncovered >= options.min_samples &&
                                    static_cast<float>(sums[c].uncovered) >= options.refine_share * count);
    fill[c] = filled.fill(cell.key, spacing_m, options.refine_factor, lacks) ? 1 : 0;
  }
  fill_.assign(fill);
  Buffer<InsertReasons> reasons(stream_, 1);
  reasons.clear();
  for_each_index(
      stream_, binned_,
      WantSample{cells, keys_.data(), order_.data(), lack_.data(), fill_.data(), wanted_.data(), reasons.data()});
  reasons_ = reasons.to_host().front();
  return with_policy(stream_, [&](auto&& policy) {
    const auto first = thrust::make_counting_iterator(std::uint32_t{0});
    std::uint32_t* const end =
        thrust::copy_if(policy, first, first + samples.count, wanted_.data(), selected_.data(), IsSet());
    return std::min(static_cast<std::uint32_t>(end - selected_.data()), options.room);
  });
}

std::vector<bool> SampleSelector::about_holes(const std::vector<CellSums>& sums) const {
  std::vector<bool> about(cells_, false);
  const auto below = [](const CellCount& cell, const CellKey& key) { return cell.key < key; };
  for (std::uint32_t c = 0; c < cells_; ++c) {
    if (sums[c].holes == 0) continue;
    for (std::uint32_t k = 0; k < kNeighbours; ++k) {
      const CellKey at = neighbour_of(search_cells_[c].key, k);
      const auto found = std::lower_bound(search_cells_.begin(), search_cells_.end(), at, below);
      if (found != search_cells_.end() && found->key == at)
        about[static_cast<std::size_t>(found - search_cells_.begin())] = true;
    }
  }
  return about;
}

}  // namespace splatbus::expander
