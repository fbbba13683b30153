#pragma once

#include <cstdint>

#include "capture-bridge/input_view.h"
#include "device/buffer.h"
#include "device/stream.h"

namespace splatbus::capture_bridge {

/// Tells input pictures that show hardly anything but what is right before the camera. One thread.
class BlindnessTest {
 public:
  /// Of views whose pictures lie on that device. Throws std::runtime_error when it cannot be had.
  explicit BlindnessTest(Device device) : stream_(device), near_(stream_, 1) {}

  /// Whether more than half of the pixels show a surface nearer than `near_m` along the camera's z.
  [[nodiscard]] bool is_blind(const InputView& view, float near_m);

 private:
  device::Stream stream_;
  device::Buffer<std::uint32_t> near_;
};

}  // namespace splatbus::capture_bridge
