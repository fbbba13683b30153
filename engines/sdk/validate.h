#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "bus/tensor.h"
#include "sdk/splatbus_engine.h"

namespace splatbus::engine_sdk {

/// Of the last frame that a handle has published.
struct EngineClock {
  std::uint64_t frame = 0;
  double time_s = 0;
};

/// What is wrong, in words that name the field, and the object or camera; or an empty string.
[[nodiscard]] std::string problem(const splatbus_camera& camera);
[[nodiscard]] std::string problem(const splatbus_camera_request& request);
[[nodiscard]] std::string problem(const splatbus_frame& frame);
/// Whether the frame may come after `last`.
[[nodiscard]] std::string problem(const splatbus_frame& frame, const EngineClock& last);

/// Name of the buffer's tensor; null unless it is exactly one known bit.
[[nodiscard]] const char* buffer_name(std::uint32_t buffer);
/// Channels of one pixel, and the type of one.
[[nodiscard]] std::size_t buffer_channels(std::uint32_t buffer);
[[nodiscard]] bus::ElementType buffer_type(std::uint32_t buffer);

}  // namespace splatbus::engine_sdk
