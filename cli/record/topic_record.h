#pragma once

#include <cstdint>
#include <map>
#include <string>

namespace splatbus::cli {

/// What became of one topic's messages.
struct TopicRecord {
  std::uint64_t messages = 0, bytes = 0;  ///< that went to the disk, or wait for it
  std::uint64_t slow_disk = 0;            ///< dropped: the queue was full
  std::uint64_t failed_disk = 0;          ///< dropped: the disk failed, or was full, before they were written
  std::uint64_t beyond_limit = 0;         ///< dropped: the file had reached its limit before they were written
  std::uint64_t overwritten = 0;  ///< dropped: a tensor's slot was written again, or its slab gone, before it was read
  std::uint64_t refused = 0;      ///< dropped: they make no sense
  std::uint64_t lost = 0;         ///< never arrived here, by gaps in their sequence
  [[nodiscard]] std::uint64_t dropped() const {
    return slow_disk + failed_disk + beyond_limit + overwritten + refused + lost;
  }
  TopicRecord& operator+=(const TopicRecord& other);
};
using TopicRecords = std::map<std::string, TopicRecord>;  ///< by topic

/// "12 (slow disk 9, overwritten 3)"; empty when nothing is missing.
[[nodiscard]] std::string describe_drops(const TopicRecord& record);

}  // namespace splatbus::cli
