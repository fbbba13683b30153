#include "topic_record.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <string_view>
#include <vector>

namespace splatbus::cli {

std::string describe_drops(const TopicRecord& record) {
  if (record.dropped() == 0) return {};
  std::vector<std::string> reasons;
  const auto add = [&](std::string_view reason, std::uint64_t count) {
    if (count > 0) reasons.push_back(fmt::format("{} {}", reason, count));
  };
  add("slow disk", record.slow_disk);
  add("failed disk", record.failed_disk);
  add("beyond the limit", record.beyond_limit);
  add("overwritten", record.overwritten);
  add("refused", record.refused);
  add("lost", record.lost);
  return fmt::format("{} ({})", record.dropped(), fmt::join(reasons, ", "));
}

TopicRecord& TopicRecord::operator+=(const TopicRecord& other) {
  messages += other.messages;
  bytes += other.bytes;
  slow_disk += other.slow_disk;
  failed_disk += other.failed_disk;
  beyond_limit += other.beyond_limit;
  overwritten += other.overwritten;
  refused += other.refused;
  lost += other.lost;
  return *this;
}

}  // namespace splatbus::cli
