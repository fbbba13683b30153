#include "topic_statistics.h"

namespace splatbus::cli {

namespace {

using Strings = flatbuffers::Vector<flatbuffers::Offset<flatbuffers::String>>;

std::set<std::string> to_set(const Strings* strings) {
  std::set<std::string> result;
  if (strings == nullptr) return result;
  for (const flatbuffers::String* string : *strings) result.insert(string->str());
  return result;
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
                                           .bytes = topic->bytes()};
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
  return {.messages = messages,
          .rate_hz = static_cast<double>(messages) / seconds,
          .megabits_per_s = static_cast<double>(now->second.bytes - earlier.bytes) * 8e-6 / seconds};
}

}  // namespace splatbus::cli
