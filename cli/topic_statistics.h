#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <string>

#include "bus/subscriber.h"

namespace splatbus::cli {

/// What was seen of one topic.
struct TopicStatistics {
  std::set<std::string> schemas, sources;
  std::uint64_t messages = 0;
  std::uint64_t resent = 0;  ///< of those, last values that the broker held
  std::uint64_t bytes = 0;   ///< messages and the tensors that they announce, wherever those lie
  bool latched = false;

  void add(const bus::Message& message);
  /// New messages a second, over `window_ns` of listening.
  [[nodiscard]] double rate_hz(std::int64_t window_ns) const;
  [[nodiscard]] double megabits_per_s(std::int64_t window_ns) const;
};

using TopicTable = std::map<std::string, TopicStatistics>;

/// Bytes of a message and of its tensors.
[[nodiscard]] std::uint64_t message_bytes(const bus::Message& message);

}  // namespace splatbus::cli
