#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <string>

#include "wire/system_generated.h"

namespace splatbus::cli {

/// What the broker has said of one topic.
struct TopicSeen {
  std::set<std::string> schemas, sources;
  bool latched = false;
  std::uint64_t messages = 0;      ///< since the broker started
  std::uint64_t bytes = 0;         ///< messages and the tensors that they announce, wherever those lie
  std::uint64_t shared_bytes = 0;  ///< of these, in slabs
  wire::Spread intervals, transits, ages;
  std::set<std::string> subscribers;
  std::map<std::string, std::uint64_t>
      source_messages;  ///< of each of `sources`; empty: an older broker, which says none
};

/// Of a quantity between two snapshots; least and greatest of the snapshots from after the first to the last.
struct Summary {
  std::uint64_t count = 0;
  double mean_s = 0, deviation_s = 0, least_s = 0, greatest_s = 0;
};

/// One sys/topics.
struct TopicSnapshot {
  std::int64_t published_ns = 0;
  std::map<std::string, TopicSeen> topics;
};

[[nodiscard]] TopicSnapshot read_topics(const wire::Topics& topics);

/// What came of a topic between two snapshots.
struct TopicTraffic {
  std::uint64_t messages = 0;
  double rate_hz = 0;
  double megabits_per_s = 0;         ///< that crossed a socket
  double shared_megabits_per_s = 0;  ///< in slabs, which cross none on this machine
  Summary intervals, transits, ages;
};

/// All zero when no time lies between them, and when the broker has started again.
[[nodiscard]] TopicTraffic traffic_between(const TopicSnapshot& before, const TopicSnapshot& after,
                                           const std::string& topic);

/// Messages a second of each source, over all topics; zero as above. What the broker counts for no source (beyond 16 of
/// a topic) is in none.
[[nodiscard]] std::map<std::string, double> source_rates(const TopicSnapshot& before, const TopicSnapshot& after);

}  // namespace splatbus::cli
