#include <thrust/binary_search.h>
#include <thrust/copy.h>
#include <thrust/gather.h>
#include <thrust/iterator/counting_iterator.h>
#include <thrust/merge.h>
#include <thrust/sort.h>

#include <utility>

#include "expander/cell_search.h"
#include "expander/point_grid.h"

namespace splatbus::expander {

using device::Buffer;
using device::for_each_index;
using device::StreamView;
using device::with_policy;

namespace {

struct ReadGaussian {
  InsertChannels from;
  ObjectFrames frames;
  float cell_size_m;
  unsigned level;
  CellKey* keys;
  ModelledPoint* points;  ///< may be null

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::uint32_t frame_id = from.object_id[i];
    const math::Vec3 position_m = get(from.mean, from.count, i) * frames.metres_per_unit(frame_id);
    keys[i] = cell_at(position_m, frame_id, cell_size_m, level);
    if (points != nullptr) points[i] = {position_m, get(from.normal, from.count, i)};
  }
};

struct ReadPagePoint {
  ModelPages model;
  const PageRange* pages;
  float cell_size_m;
  CellKey* keys;  ///< of each page's lanes, under the page's number for a frame
  ModelledPoint* points;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::uint32_t number = i >> kPageShift, lane = i & (kPageLanes - 1);
    const PageRange page = pages[number];
    keys[i] = {};
    if (lane >= page.range.count) return;
    const std::size_t index = std::size_t{page.range.first} + lane;
    const std::size_t at =
        (index >> model.page_shift) * model.page_stride + (index & ((std::size_t{1} << model.page_shift) - 1));
    points[i] = {get(model.surface_point + at, model.stride, 0), get(model.normal + at, model.stride, 0)};
    keys[i] = cell_at(points[i].position * page.metres_per_unit, number, cell_size_m);
  }
};

struct GatherPoint {
  const PointBlock* blocks;
  const std::uint32_t* before;  ///< points of the blocks before each
  std::uint32_t block_count;
  float cell_size_m;
  CellKey* keys;
  ModelledPoint* points;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::uint32_t b = lower_bound(before, block_count, i + 1) - 1;
    const PointBlock block = blocks[b];
    const ModelledPoint point = block.points[i - before[b]];
    points[i] = {point.position * block.metres_per_unit, point.normal};
    keys[i] = cell_at(points[i].position, block.frame_id, cell_size_m, 0);
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
    const math::Vec3 position = get(gaussians.mean, gaussians.count, i);
    const CellKey key = cell_at(position, gaussians.object_id[i], cell_size_m, 0);
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

std::vector<CellCount> count_cells(StreamView stream, CellKey* keys, std::uint32_t count) {
  with_policy(stream, [&](auto&& policy) { thrust::sort(policy, keys, keys + count, KeyBelow()); });
  const std::uint32_t named = named_count(stream, keys, count);
  Buffer<CellKey> cells(stream, named);
  Buffer<std::uint32_t> start(stream, named);
  const std::uint32_t found = list_cells(stream, keys, named, cells.data(), start.data());
  return counts_of(stream, cells.data(), start.data(), found, named);
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

PageCells read_pages(StreamView stream, const ModelPages& model, std::span<const PageRange> pages, float cell_size_m,
                     ModelledPoint* points) {
  PageCells found;
  const auto lanes = static_cast<std::uint32_t>(pages.size()) << kPageShift;
  Buffer<PageRange> there(stream);
  there.assign(pages);
  Buffer<CellKey> keys(stream, lanes);
  for_each_index(stream, lanes, ReadPagePoint{model, there.data(), cell_size_m, keys.data(), points});
  found.cells = count_cells(stream, keys.data(), lanes);
  for (CellCount& cell : found.cells) {
    const std::uint32_t page = cell.key.object_id;
    while (found.first.size() <= page) {
      found.first.push_back(static_cast<std::uint32_t>(&cell - found.cells.data()));
    }
    cell.key.object_id = pages[page].range.frame_id;
  }
  found.first.resize(pages.size() + 1, static_cast<std::uint32_t>(found.cells.size()));
  return found;
}

std::vector<CellCount> cells_of(StreamView stream, const InsertChannels& gaussians,
                                std::span<const ObjectFrame> objects, float cell_size_m, unsigned level) {
  Buffer<ObjectFrame> there(stream);
  there.assign(objects);
  Buffer<CellKey> keys(stream, gaussians.count);
  const ObjectFrames frames{there.data(), static_cast<std::uint32_t>(objects.size())};
  for_each_index(stream, gaussians.count, ReadGaussian{gaussians, frames, cell_size_m, level, keys.data(), nullptr});
  return count_cells(stream, keys.data(), gaussians.count);
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

void PointGrid::add(std::span<const InsertChannels> batches, std::span<const ObjectFrame> objects) {
  std::uint32_t count = 0;
  for (const InsertChannels& batch : batches) count += batch.count;
  if (count == 0) return;
  Buffer<ObjectFrame> there(stream_);
  there.assign(objects);
  const ObjectFrames frames{there.data(), static_cast<std::uint32_t>(objects.size())};
  reserve(new_keys_, count);
  reserve(new_points_, count);
  std::uint32_t first = 0;
  for (const InsertChannels& batch : batches) {
    for_each_index(stream_, batch.count,
                   ReadGaussian{batch, frames, cell_size_m_, 0, new_keys_.data() + first, new_points_.data() + first});
    first += batch.count;
  }
  with_policy(stream_, [&](auto&& policy) {
    thrust::sort_by_key(policy, new_keys_.data(), new_keys_.data() + count, new_points_.data(), KeyBelow());
  });
  count = named_count(stream_, new_keys_.data(), count);
  const std::uint32_t all = count_ + count;
  reserve(merged_keys_, all);
  reserve(merged_points_, all);
  with_policy(stream_, [&](auto&& policy) {
    thrust::merge_by_key(policy, keys_.data(), keys_.data() + count_, new_keys_.data(), new_keys_.data() + count,
                         points_.data(), new_points_.data(), merged_keys_.data(), merged_points_.data(), KeyBelow());
  });
  std::swap(keys_, merged_keys_);
  std::swap(points_, merged_points_);
  count_ = all;
}

void PointGrid::assign(std::span<const PointBlock> blocks) {
  std::vector<std::uint32_t> before;
  std::uint32_t count = 0;
  for (const PointBlock& block : blocks) {
    before.push_back(count);
    count += block.count;
  }
  count_ = 0;
  if (count == 0) return;
  Buffer<PointBlock> blocks_there(stream_);
  Buffer<std::uint32_t> before_there(stream_);
  blocks_there.assign(blocks);
  before_there.assign(before);
  reserve(keys_, count);
  reserve(points_, count);
  for_each_index(stream_, count,
                 GatherPoint{blocks_there.data(), before_there.data(), static_cast<std::uint32_t>(blocks.size()),
                             cell_size_m_, keys_.data(), points_.data()});
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

}  // namespace splatbus::expander
