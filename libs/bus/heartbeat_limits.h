#pragma once

#include <cstddef>

namespace splatbus::bus {

/// What a heartbeat may have: the broker refuses one with more.
struct HeartbeatLimits {
  static constexpr std::size_t kBytes = std::size_t{256} << 10;  ///< of all of it
  static constexpr std::size_t kName = 64;                       ///< its source, its service and its backend
  static constexpr std::size_t kKey = 256;                       ///< the name of a counter or a parameter
  static constexpr std::size_t kText = 4096;                     ///< its detail, and a parameter's value
  static constexpr std::size_t kEntries = 1024;                  ///< counters, and parameters
};

}  // namespace splatbus::bus
