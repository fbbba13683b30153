// Where Gaussians go: their keys, their order, and the indices they get.

#include <thrust/binary_search.h>
#include <thrust/copy.h>
#include <thrust/remove.h>
#include <thrust/scan.h>
#include <thrust/sort.h>
#include <thrust/transform_scan.h>

#include "device/parallel.h"
#include "model/page_kernels.h"

namespace splatbus::model {

namespace {

using device::for_each_index;
using device::with_policy;

struct ItemLess {
  SPLATBUS_PORTABLE_MEMBER bool operator()(const Item& a, const Item& b) const {
    if (a.group != b.group) return a.group < b.group;
    return a.morton != b.morton ? a.morton < b.morton : a.id < b.id;
  }
};

/// How many of `count` ascending values, got by at(k), are not above `value`.
template <class At>
SPLATBUS_PORTABLE_MEMBER std::uint32_t count_up_to(std::uint32_t value, std::uint32_t count, const At& at) {
  std::uint32_t low = 0, high = count;
  while (low < high) {
    const std::uint32_t middle = (low + high) / 2;
    if (at(middle) <= value) {
      low = middle + 1;
    } else {
      high = middle;
    }
  }
  return low;
}

struct ListRow {
  InsertRows rows;
  std::uint64_t first_id;
  Item* items;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t k) const {
    const math::Vec3 mean{rows.mean[k], rows.mean[rows.stride + k], rows.mean[2 * rows.stride + k]};
    items[k] = {morton_key(mean), first_id + k, rows.object_id[k], k};
  }
};

struct IsSpilled {
  InsertRows rows;
  const SpilledRange* spilled;
  std::uint32_t spilled_count;
  SPLATBUS_PORTABLE_MEMBER bool operator()(const Item& item) const {
    const auto before = [&item](const SpilledRange& range) {
      return range.frame_id != item.group ? range.frame_id < item.group : range.morton_first <= item.morton;
    };
    std::uint32_t low = 0, high = spilled_count;
    while (low < high) {
      const std::uint32_t middle = (low + high) / 2;
      if (before(spilled[middle])) {
        low = middle + 1;
      } else {
        high = middle;
      }
    }
    // What was inserted around a page that is not here may have made another one within its range of keys.
    constexpr std::uint32_t kOverlaps = 8;
    constexpr float kMargin_m = 0.05F;
    const std::size_t k = item.source;
    const math::Vec3 at{rows.mean[k], rows.mean[rows.stride + k], rows.mean[2 * rows.stride + k]};
    for (std::uint32_t s = low; s > 0 && low - s < kOverlaps; --s) {
      const SpilledRange& range = spilled[s - 1];
      if (range.frame_id != item.group) return false;
      const auto within = [](float x, float least, float most) {
        return x >= least - kMargin_m && x <= most + kMargin_m;
      };
      if (item.morton <= range.morton_last && within(at.x, range.low_m.x, range.high_m.x) &&
          within(at.y, range.low_m.y, range.high_m.y) && within(at.z, range.low_m.z, range.high_m.z)) {
        return true;
      }
    }
    return false;
  }
};

SPLATBUS_PORTABLE_MEMBER std::uint64_t key_of(const PageMemory& memory, std::uint32_t index) {
  // Where its sample was, which training does not move: a key that stays.
  return morton_key({*memory.value(memory.surface_point, index), *memory.value(memory.surface_point + 1, index),
                     *memory.value(memory.surface_point + 2, index)});
}

struct ListCopy {
  PageMemory memory;
  const std::uint32_t* indices;
  const IndexRange* ranges;
  std::uint32_t range_count;
  std::uint64_t first_id;
  Item* items;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t k) const {
    const IndexRange* const all = ranges;
    const std::uint32_t range =
        count_up_to(indices[k], range_count, [all](std::uint32_t r) { return all[r].first; }) - 1;
    items[k] = {key_of(memory, indices[k]), first_id + k, ranges[range].frame_id, k};
  }
};

struct BeginsGroup {
  const Item* items;
  SPLATBUS_PORTABLE_MEMBER bool operator()(std::uint32_t i) const {
    return i == 0 || items[i].group != items[i - 1].group;
  }
};

struct TakeGroup {
  const Item* items;
  std::uint32_t* in_out;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t k) const { in_out[k] = items[in_out[k]].group; }
};

struct FindFirst {
  const Item* items;
  std::uint32_t count;
  const Bound* bounds;
  std::uint32_t* first;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t k) const {
    const Item bound{bounds[k].morton, bounds[k].id, bounds[k].frame_id, 0};
    std::uint32_t low = 0, high = count;
    while (low < high) {
      const std::uint32_t middle = (low + high) / 2;
      if (ItemLess()(items[middle], bound)) {
        low = middle + 1;
      } else {
        high = middle;
      }
    }
    first[k] = low;
  }
};

struct PlaceAppend {
  const Item* items;
  const Append* appends;
  std::uint32_t append_count;
  std::uint32_t* to;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const Append* const all = appends;
    const Append& append = all[count_up_to(i, append_count, [all](std::uint32_t a) { return all[a].first_item; }) - 1];
    if (append.index == kNotInserted) return;
    const std::uint32_t place = i - append.first_item;
    to[items[i].source] = place < append.room ? append.index + place : kNotInserted;
  }
};

/// Which split an item of all splits is of.
SPLATBUS_PORTABLE_MEMBER std::uint32_t split_of(const Split* splits, std::uint32_t split_count, std::uint32_t i) {
  return count_up_to(i, split_count, [splits](std::uint32_t s) { return splits[s].first; }) - 1;
}

struct ListSplit {
  PageMemory memory;
  const Split* splits;
  std::uint32_t split_count;
  const Item* items;
  Item* split_items;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const std::uint32_t s = split_of(splits, split_count, i);
    const Split& split = splits[s];
    const std::uint32_t k = i - split.first;
    if (k < split.old_count) {
      const std::uint32_t index = split.old_index + k;
      split_items[i] = {key_of(memory, index), *memory.wide(memory.gaussian_id, index), s, kFromPage | index};
    } else {
      const Item& item = items[split.first_item + k - split.old_count];
      split_items[i] = {item.morton, item.id, s, item.source};
    }
  }
};

struct IsOld {
  const Item* items;
  SPLATBUS_PORTABLE_MEMBER std::uint32_t operator()(std::uint32_t i) const { return items[i].source >> 31U; }
};

struct PlaceSplit {
  const Split* splits;
  const Item* split_items;
  const std::uint32_t* new_pages;
  const std::uint32_t* moves_before;
  std::uint32_t *to, *moved_from, *moved_to;
  Bound* first_keys;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const Item& item = split_items[i];
    const Split& split = splits[item.group];
    const std::uint64_t total = split.old_count + split.item_count, pages = split.new_page_count;
    const std::uint64_t k = i - split.first;
    // Page q takes the items from q total / pages on.
    const std::uint64_t q = ((k + 1) * pages - 1) / total;
    const auto lane = static_cast<std::uint32_t>(k - q * total / pages);
    const std::uint32_t page = split.first_new_page + static_cast<std::uint32_t>(q);
    const std::uint32_t index = new_pages[page] * kPageLanes + lane;
    if (lane == 0) first_keys[page] = {item.morton, item.id, 0};
    if ((item.source & kFromPage) == 0) {
      to[item.source] = index;
    } else {
      moved_from[moves_before[i]] = item.source & ~kFromPage;
      moved_to[moves_before[i]] = index;
    }
  }
};

struct ListLaneMove {
  const LaneMove* lanes;
  std::uint32_t lane_count;
  std::uint32_t *from, *to;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t i) const {
    const LaneMove* const all = lanes;
    const LaneMove& move = all[count_up_to(i, lane_count, [all](std::uint32_t m) { return all[m].first; }) - 1];
    from[i] = move.from + (i - move.first);
    to[i] = move.to + (i - move.first);
  }
};

}  // namespace

void list_rows(StreamView stream, const InsertRows& rows, std::uint32_t count, std::uint64_t first_id, Item* items) {
  for_each_index(stream, count, ListRow{rows, first_id, items});
}

std::uint32_t drop_spilled(StreamView stream, const InsertRows& rows, std::span<const SpilledRange> spilled,
                           Item* items, std::uint32_t count) {
  if (spilled.empty()) return count;
  const Buffer<SpilledRange> on_device = uploaded(stream, spilled);
  const IsSpilled is_spilled{rows, on_device.data(), static_cast<std::uint32_t>(spilled.size())};
  Item* const end =
      with_policy(stream, [&](auto&& policy) { return thrust::remove_if(policy, items, items + count, is_spilled); });
  stream.wait();
  return static_cast<std::uint32_t>(end - items);
}

void list_copies(StreamView stream, const PageMemory& memory, const std::uint32_t* indices, std::uint32_t count,
                 const IndexRange* ranges, std::uint32_t range_count, std::uint64_t first_id, Item* items) {
  for_each_index(stream, count, ListCopy{memory, indices, ranges, range_count, first_id, items});
}

void sort_items(StreamView stream, Item* items, std::uint32_t count) {
  with_policy(stream, [&](auto&& policy) { thrust::sort(policy, items, items + count, ItemLess()); });
}

std::vector<std::uint32_t> list_groups(StreamView stream, const Item* items, std::uint32_t count) {
  Buffer<std::uint32_t> groups(stream, count);
  const auto found = with_policy(stream, [&](auto&& policy) {
    const auto first = thrust::make_counting_iterator(std::uint32_t{0});
    return thrust::copy_if(policy, first, first + count, groups.data(), BeginsGroup{items}) - groups.data();
  });
  for_each_index(stream, static_cast<std::uint32_t>(found), TakeGroup{items, groups.data()});
  groups.resize(static_cast<std::size_t>(found));
  return groups.to_host();
}

std::vector<std::uint32_t> first_items(StreamView stream, const Item* items, std::uint32_t count,
                                       std::span<const Bound> bounds) {
  const Buffer<Bound> on_device = uploaded(stream, bounds);
  Buffer<std::uint32_t> first(stream, bounds.size());
  for_each_index(stream, static_cast<std::uint32_t>(bounds.size()),
                 FindFirst{items, count, on_device.data(), first.data()});
  return first.to_host();
}

void place_appends(StreamView stream, const Item* items, std::uint32_t count, std::span<const Append> appends,
                   std::uint32_t* to) {
  const Buffer<Append> on_device = uploaded(stream, appends);
  for_each_index(stream, count, PlaceAppend{items, on_device.data(), static_cast<std::uint32_t>(appends.size()), to});
  stream.wait();
}

void list_moves(StreamView stream, std::span<const LaneMove> lanes, std::uint32_t* from, std::uint32_t* to) {
  if (lanes.empty()) return;
  const Buffer<LaneMove> on_device = uploaded(stream, lanes);
  for_each_index(stream, lanes.back().first + lanes.back().count,
                 ListLaneMove{on_device.data(), static_cast<std::uint32_t>(lanes.size()), from, to});
  stream.wait();
}

std::vector<Bound> place_splits(StreamView stream, const PageMemory& memory, const Item* items,
                                std::span<const Split> splits, std::span<const std::uint32_t> new_pages,
                                std::uint32_t* to, std::uint32_t* moved_from, std::uint32_t* moved_to) {
  if (splits.empty()) return {};
  const std::uint32_t total = splits.back().first + splits.back().old_count + splits.back().item_count;
  const auto split_count = static_cast<std::uint32_t>(splits.size());
  const Buffer<Split> on_device = uploaded(stream, splits);
  const Buffer<std::uint32_t> pages = uploaded(stream, new_pages);
  Buffer<Item> split_items(stream, total);
  for_each_index(stream, total, ListSplit{memory, on_device.data(), split_count, items, split_items.data()});
  sort_items(stream, split_items.data(), total);
  Buffer<std::uint32_t> moves_before(stream, total);
  with_policy(stream, [&](auto&& policy) {
    const auto first = thrust::make_counting_iterator(std::uint32_t{0});
    thrust::transform_exclusive_scan(policy, first, first + total, moves_before.data(), IsOld{split_items.data()},
                                     std::uint32_t{0}, thrust::plus<std::uint32_t>());
  });
  Buffer<Bound> first_keys(stream, new_pages.size());
  for_each_index(stream, total,
                 PlaceSplit{on_device.data(), split_items.data(), pages.data(), moves_before.data(), to, moved_from,
                            moved_to, first_keys.data()});
  return first_keys.to_host();
}

}  // namespace splatbus::model
