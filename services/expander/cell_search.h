#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "device/buffer.h"
#include "device/parallel.h"
#include "expander/insertion.h"

// What the sources of insertion.h and point_grid.h share.
namespace splatbus::expander {

/// Room for `count`, with some to spare for the next time.
template <class T>
void reserve(device::Buffer<T>& buffer, std::size_t count) {
  if (buffer.size() < count) buffer.resize(std::max(count, 2 * buffer.size()));
}

struct KeyBelow {
  SPLATBUS_PORTABLE_MEMBER bool operator()(const CellKey& a, const CellKey& b) const { return a < b; }
};

/// First of ascending elements that does not lie below `value`; `count` when all do.
template <class T>
SPLATBUS_PORTABLE std::uint32_t lower_bound(const T* elements, std::uint32_t count, const T& value) {
  std::uint32_t first = 0;
  while (count > 0) {
    const std::uint32_t half = count / 2;
    if (elements[first + half] < value) {
      first += half + 1;
      count -= half + 1;
    } else {
      count = half;
    }
  }
  return first;
}

/// The same, for one that is expected among the first.
template <class T>
SPLATBUS_PORTABLE std::uint32_t near_lower_bound(const T* elements, std::uint32_t count, const T& value) {
  std::uint32_t below = 0, end = 1;
  while (end < count && elements[end - 1] < value) {
    below = end;
    end = 2 * end < count ? 2 * end : count;
  }
  return below + lower_bound(elements + below, (end < count ? end : count) - below, value);
}

SPLATBUS_PORTABLE math::Vec3 get(const float* channel, std::size_t stride, std::size_t i) {
  return {channel[i], channel[stride + i], channel[2 * stride + i]};
}
SPLATBUS_PORTABLE void put(float* channel, std::size_t stride, std::size_t i, const math::Vec3& v) {
  channel[i] = v.x;
  channel[stride + i] = v.y;
  channel[2 * stride + i] = v.z;
}

/// Cells of ascending keys, none of them kNoCell, and where each begins; returns how many there are.
[[nodiscard]] std::uint32_t list_cells(device::StreamView stream, const CellKey* keys, std::uint32_t count,
                                       CellKey* cells, std::uint32_t* start);
/// The same cells in host memory, of `points` points in all.
[[nodiscard]] std::vector<CellCount> counts_of(device::StreamView stream, const CellKey* cells,
                                               const std::uint32_t* start, std::uint32_t count, std::uint32_t points);
/// Sorts keys and counts those of each cell; what has none is in none.
[[nodiscard]] std::vector<CellCount> count_cells(device::StreamView stream, CellKey* keys, std::uint32_t count);
/// How many of ascending keys name a cell.
[[nodiscard]] std::uint32_t named_count(device::StreamView stream, const CellKey* keys, std::uint32_t count);

}  // namespace splatbus::expander
