#include "topic_statistics.h"

#include <algorithm>
#include <cmath>

namespace splatbus::cli {

namespace {

using Strings = flatbuffers::Vector<flatbuffers::Offset<flatbuffers::String>>;

std::set<std::string> to_set(const Strings* strings) {
  std::set<std::string> result;
  if (strings == nullptr) return result;
  for (const flatbuffers::String* string : *strings) result.insert(string->str());
  return result;
}

std::map<std::string, std::uint64_t> counts_of(const wire::TopicInfo& topic) {
  std::map<std::string, std::uint64_t> result;
  const auto* names = topic.sources();
  const auto* counts = topic.source_messages();
  if (names == nullptr || counts == nullptr) return result;
  for (flatbuffers::uoffset_t i = 0; i < std::min(names->size(), counts->size()); ++i) {
    result[names->Get(i)->str()] = counts->Get(i);
  }
  return result;
}

/// An older broker says none.
wire::Spread value_of(const wire::Spread* spread) {
  return spread != nullptr ? *spread : wire::Spread();
}

Summary summary(const wire::Spread& before, const wire::Spread& after) {
  if (after.count() <= before.count()) return {};
  const auto count = static_cast<double>(after.count() - before.count());
  const double mean = (after.sum_s() - before.sum_s()) / count;
  const double variance = (after.squares_s2() - before.squares_s2()) / count - mean * mean;
  return {.count = after.count() - before.count(),
          .mean_s = mean,
          .deviation_s = std::sqrt(std::max(0.0, variance)),
          .least_s = after.least_s(),
          .greatest_s = after.greatest_s()};
}

}  // namespace

TopicSnapshot read_topics(const wire::Topics& topics) {
  TopicSnapshot result{.published_ns = topics.header()->publish_ns(), .topics = {}};
  if (topics.topics() == nullptr) return result;
  for (const wire::TopicInfo* topic : *topics.topics()) {
    result.topics[topic->name()->str()] = {.schemas = to_set(topic->schemas()),
                                           .sources = to_set(topic->sources()),
                                           .latched = topic->latched(),
                                           .messages = topic->messages(),
                                           .bytes = topic->bytes(),
                                           .shared_bytes = topic->shared_bytes(),
                                           .intervals = value_of(topic->intervals()),
                                           .transits = value_of(topic->transits()),
                                           .ages = value_of(topic->ages()),
                                           .subscribers = to_set(topic->subscribers()),
                                           .source_messages = counts_of(*topic)};
  }
  return result;
}

TopicTraffic traffic_between(const TopicSnapshot& before, const TopicSnapshot& after, const std::string& topic) {
  const auto now = after.topics.find(topic);
  if (now == after.topics.end() || after.published_ns <= before.published_ns) return {};
  const auto then = before.topics.find(topic);
  const TopicSeen none, &earlier = then == before.topics.end() ? none : then->second;
  if (now->second.messages < earlier.messages) return {};
  const double seconds = static_cast<double>(after.published_ns - before.published_ns) / 1e9;
  const std::uint64_t messages = now->second.messages - earlier.messages;
  const std::uint64_t shared = now->second.shared_bytes - earlier.shared_bytes;
  return {.messages = messages,
          .rate_hz = static_cast<double>(messages) / seconds,
          .megabits_per_s = static_cast<double>(now->second.bytes - earlier.bytes - shared) * 8e-6 / seconds,
          .shared_megabits_per_s = static_cast<double>(shared) * 8e-6 / seconds,
          .intervals = summary(earlier.intervals, now->second.intervals),
          .transits = summary(earlier.transits, now->second.transits),
          .ages = summary(earlier.ages, now->second.ages)};
}

std::map<std::string, double> source_rates(const TopicSnapshot& before, const TopicSnapshot& after) {
  std::map<std::string, double> rates;
  if (after.published_ns <= before.published_ns) return rates;
  const double seconds = static_cast<double>(after.published_ns - before.published_ns) / 1e9;
  for (const auto& [name, seen] : after.topics) {
    if (seen.source_messages.empty()) {
      if (seen.sources.size() == 1) rates[*seen.sources.begin()] += traffic_between(before, after, name).rate_hz;
      continue;
    }
    const auto then = before.topics.find(name);
    for (const auto& [source, messages] : seen.source_messages) {
      std::uint64_t earlier = 0;
      if (then != before.topics.end()) {
        const auto found = then->second.source_messages.find(source);
        if (found != then->second.source_messages.end()) earlier = found->second;
      }
      if (messages > earlier) rates[source] += static_cast<double>(messages - earlier) / seconds;
    }
  }
  return rates;
}

}  // namespace splatbus::cli
