#include "capture-bridge/near_pixels.h"
#include "device/parallel.h"

namespace splatbus::capture_bridge {

namespace {

/// A row of pixels an item.
struct CountNear {
  SeenPositions seen;
  float near_m;
  std::uint32_t* count;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t row) const {
    std::uint32_t near = 0;
    for (std::uint32_t i = row * seen.width; i < (row + 1) * seen.width; ++i) {
      if (seen.object_id[i] != 0 && dot(seen.axis, math::load4(seen.position, i).xyz - seen.eye) < near_m) ++near;
    }
    device::atomic_add(count, near);
  }
};

}  // namespace

void count_near(device::StreamView stream, const SeenPositions& seen, float near_m, std::uint32_t* count) {
  device::for_each_index(stream, seen.height, CountNear{.seen = seen, .near_m = near_m, .count = count});
}

}  // namespace splatbus::capture_bridge
