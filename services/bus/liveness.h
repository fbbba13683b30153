#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "wire/system_generated.h"

namespace splatbus::bus_service {

/// Who is alive, from the heartbeats that pass. Times are CLOCK_MONOTONIC of the broker.
class Liveness {
 public:
  struct Node {
    std::string service;
    std::uint32_t pid = 0;
    std::uint64_t epoch = 0;
    wire::ServiceState state = wire::ServiceState::Starting;
    std::int64_t heard_ns = 0;
    bool alive = false;
  };

  void note(const wire::Heartbeat& heartbeat, std::int64_t now);

  /// Marks the silent as gone; returns the sources that have been gone for so long that they leave the list.
  std::vector<std::string> update(std::int64_t now);

  /// True once after something else than an age changed.
  bool take_changed();

  [[nodiscard]] const std::map<std::string, Node>& nodes() const { return nodes_; }

 private:
  std::map<std::string, Node> nodes_;
  bool changed_ = false;
};

}  // namespace splatbus::bus_service
