#include <thrust/binary_search.h>
#include <thrust/copy.h>
#include <thrust/gather.h>
#include <thrust/iterator/counting_iterator.h>
#include <thrust/merge.h>
#include <thrust/sort.h>

#include <utility>

#include "expander/cell_search.h"

namespace splatbus::expander {

using device::Buffer;
using device::for_each_index;
using device::StreamView;
using device::with_policy;

namespace {

/// Where an inserted Gaussian counts.
SPLATBUS_PORTABLE CellKey cell_of(const InsertChannels& gaussians, std::uint32_t i, float cell_size_m) {
  return cell_at(get(gaussians.mean, gaussians.count, i), gaussians.object_id[i], cell_size_m);
}

struct ReadGaussian {
  InsertChannels from;
  float cell_size_m;
  CellKey* keys;
  ModelledPoint* points;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    keys[i] = cell_of(from, i, cell_size_m);
    points[i] = {get(from.mean, from.count, i), get(from.normal, from.count, i)};
  }
};

struct ReadModelPoint {
  ModelPoints model;
  const IndexRange* ranges;
  const std::uint32_t* before;  ///< points of the ranges before each
  std::uint32_t range_count;
  float cell_size_m;
  CellKey* keys;
  ModelledPoint* points;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::uint32_t range = lower_bound(before, range_count, i + 1) - 1;
    const std::size_t index = ranges[range].first + (i - before[range]);
    const std::size_t at =
        (index >> model.page_shift) * model.page_stride + (index & ((std::size_t{1} << model.page_shift) - 1));
    points[i] = {get(model.surface_point + at, model.stride, 0), get(model.normal + at, model.stride, 0)};
    const std::uint32_t frame_id = model.object_id == nullptr ? ranges[range].frame_id : model.object_id[at];
    keys[i] = cell_at(points[i].position, frame_id, cell_size_m);
  }
};

struct FindExact {
  InsertChannels gaussians;
  float cell_size_m;
  const CellKey* keys;
  const ModelledPoint* points;
  std::uint32_t count;
  std::uint32_t* found;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const CellKey key = cell_of(gaussians, i, cell_size_m);
    const math::Vec3 position = get(gaussians.mean, gaussians.count, i);
    for (std::uint32_t p = lower_bound(keys, count, key); p < count && keys[p] == key; ++p) {
      const math::Vec3 there = points[p].position;
      if (there.x == position.x && there.y == position.y && there.z == position.z) device::atomic_add(found, 1U);
    }
  }
};

/// Of sorted keys.
struct IsFirstOfCell {
  const CellKey* keys;

  SPLATBUS_PORTABLE_MEMBER bool operator()(std::uint32_t i) const { return i == 0 || !(keys[i] == keys[i - 1]); }
};

}  // namespace

std::uint32_t list_cells(StreamView stream, const CellKey* keys, std::uint32_t count, CellKey* cells,
                         std::uint32_t* start) {
  // Not unique_by_key_copy(): on the host it reads the key before the first.
  return with_policy(stream, [&](auto&& policy) {
    const auto all = thrust::make_counting_iterator(std::uint32_t{0});
    std::uint32_t* const end = thrust::copy_if(policy, all, all + count, start, IsFirstOfCell{keys});
    thrust::gather(policy, start, end, keys, cells);
    return static_cast<std::uint32_t>(end - start);
  });
}

std::vector<CellCount> counts_of(StreamView stream, const CellKey* keys, const std::uint32_t* start,
                                 std::uint32_t cells, std::uint32_t points) {
  std::vector<CellKey> host_keys(cells);
  std::vector<std::uint32_t> host_start(cells);
  device::copy(stream, host_keys.data(), keys, cells * sizeof(CellKey));
  device::copy(stream, host_start.data(), start, cells * sizeof(std::uint32_t));
  stream.wait();
  host_start.push_back(points);
  std::vector<CellCount> counts(cells);
  for (std::uint32_t i = 0; i < cells; ++i) counts[i] = {host_keys[i], host_start[i + 1] - host_start[i]};
  return counts;
}

std::uint32_t named_count(StreamView stream, const CellKey* keys, std::uint32_t count) {
  return with_policy(stream, [&](auto&& policy) {
    return static_cast<std::uint32_t>(thrust::lower_bound(policy, keys, keys + count, CellKey{}, KeyBelow()) - keys);
  });
}

InsertChannels insert_channels_at(std::byte* memory, std::uint32_t count) {
  auto* next = reinterpret_cast<float*>(memory);
  const auto take = [&](std::size_t channels) {
    float* const channel = next;
    next += channels * count;
    return channel;
  };
  InsertChannels out{};
  out.mean = take(3);
  out.log_scale = take(3);
  out.rotation = take(4);
  out.opacity_logit = take(1);
  out.albedo = take(3);
  out.normal = take(3);
  out.visibility = take(1);
  out.object_id = reinterpret_cast<std::uint32_t*>(next);
  out.count = count;
  return out;
}

PointGrid::PointGrid(StreamView stream, float cell_size_m)
    : stream_(stream),
      cell_size_m_(cell_size_m),
      keys_(stream),
      new_keys_(stream),
      merged_keys_(stream),
      points_(stream),
      new_points_(stream),
      merged_points_(stream) {}

void PointGrid::add(std::span<const InsertChannels> batches) {
  std::uint32_t count = 0;
  for (const InsertChannels& batch : batches) count += batch.count;
  if (count == 0) return;
  const std::uint32_t all = count_ + count;
  reserve(new_keys_, count);
  reserve(new_points_, count);
  reserve(merged_keys_, all);
  reserve(merged_points_, all);
  std::uint32_t first = 0;
  for (const InsertChannels& batch : batches) {
    for_each_index(stream_, batch.count,
                   ReadGaussian{batch, cell_size_m_, new_keys_.data() + first, new_points_.data() + first});
    first += batch.count;
  }
  with_policy(stream_, [&](auto&& policy) {
    thrust::sort_by_key(policy, new_keys_.data(), new_keys_.data() + count, new_points_.data(), KeyBelow());
    thrust::merge_by_key(policy, keys_.data(), keys_.data() + count_, new_keys_.data(), new_keys_.data() + count,
                         points_.data(), new_points_.data(), merged_keys_.data(), merged_points_.data(), KeyBelow());
  });
  std::swap(keys_, merged_keys_);
  std::swap(points_, merged_points_);
  count_ = all;
}

void PointGrid::assign(const ModelPoints& model) {
  std::vector<IndexRange> ranges;
  std::vector<std::uint32_t> before;
  std::uint32_t count = 0;
  for (const IndexRange& range : model.ranges) {
    if (range.count == 0) continue;
    ranges.push_back(range);
    before.push_back(count);
    count += range.count;
  }
  count_ = 0;
  if (count == 0) return;
  Buffer<IndexRange> ranges_there(stream_);
  Buffer<std::uint32_t> before_there(stream_);
  ranges_there.assign(ranges);
  before_there.assign(before);
  reserve(keys_, count);
  reserve(points_, count);
  for_each_index(stream_, count,
                 ReadModelPoint{model, ranges_there.data(), before_there.data(),
                                static_cast<std::uint32_t>(ranges.size()), cell_size_m_, keys_.data(), points_.data()});
  with_policy(stream_, [&](auto&& policy) {
    thrust::sort_by_key(policy, keys_.data(), keys_.data() + count, points_.data(), KeyBelow());
  });
  count_ = named_count(stream_, keys_.data(), count);
}

bool PointGrid::holds_any(const InsertChannels& gaussians) const {
  Buffer<std::uint32_t> found(stream_, 1);
  found.clear();
  for_each_index(stream_, gaussians.count,
                 FindExact{gaussians, cell_size_m_, keys_.data(), points_.data(), count_, found.data()});
  return found.to_host().front() != 0;
}

std::vector<CellCount> PointGrid::cells() const {
  Buffer<CellKey> cells(stream_, count_);
  Buffer<std::uint32_t> start(stream_, count_);
  const std::uint32_t found = list_cells(stream_, keys_.data(), count_, cells.data(), start.data());
  return counts_of(stream_, cells.data(), start.data(), found, count_);
}

}  // namespace splatbus::expander
