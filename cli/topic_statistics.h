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
  std::uint64_t bytes = 0;  ///< messages and the tensors that they announce, wherever those lie
  std::int64_t first_ns = 0, last_ns = 0;
  bool latched = false;

  void add(const bus::Message& message, std::int64_t now_ns);
  /// Messages a second between the first and the last; 0 when fewer than two were seen.
  [[nodiscard]] double rate_hz() const;
  /// Over `window_ns`.
  [[nodiscard]] double megabits_per_s(std::int64_t window_ns) const;
};

using TopicTable = std::map<std::string, TopicStatistics>;

/// Bytes of a message and of its tensors.
[[nodiscard]] std::uint64_t message_bytes(const bus::Message& message);

}  // namespace splatbus::cli
