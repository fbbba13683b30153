#include "topic_watch.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstdio>
#include <optional>
#include <stdexcept>

#include "bus/nearest.h"
#include "bus/subscriber.h"
#include "supervised_run.h"
#include "verbs.h"

namespace splatbus::cli {

bool is_asked_for(const TopicOptions& options, const std::string& topic) {
  return std::any_of(options.topics.begin(), options.topics.end(), [&](const std::string& asked) {
    return asked.ends_with('*') ? topic.starts_with(asked.substr(0, asked.size() - 1)) : topic == asked;
  });
}

void name_absent(const char* verb, const TopicOptions& options, const std::vector<std::string>& there) {
  for (const std::string& asked : options.topics) {
    TopicOptions one;
    one.topics = {asked};
    if (std::ranges::any_of(there, [&](const auto& topic) { return is_asked_for(one, topic); })) continue;
    const std::string meant = bus::nearest(asked, there);
    fmt::print(stderr, "splatbus topic {}: nothing has been published on '{}'{}\n", verb, asked,
               meant.empty() ? "; 'splatbus topic list' shows what has" : fmt::format("; did you mean '{}'?", meant));
  }
}

void print(const std::string& text) {
  fmt::print("{}\n", text);
  std::fflush(stdout);
}

std::pair<TopicSnapshot, TopicSnapshot> follow_topics(
    const TopicOptions& options, const std::function<void(const TopicSnapshot&, const TopicSnapshot&)>& each) {
  const StopSignals signals;
  bus::Subscriber subscriber(connect(bus_address(options.bus)));
  std::optional<TopicSnapshot> first;
  TopicSnapshot last;
  subscriber.on(topics::kTopics, [&](const wire::Topics& topics, const bus::Message&) {
    TopicSnapshot next = read_topics(topics);
    if (first) each(last, next);
    if (!first) first = next;
    last = std::move(next);
  });
  for (const Deadline deadline(options.seconds); !deadline.passed() && !signals.stop().stop_requested();) {
    subscriber.dispatch_all(kPatience);
  }
  return {first.value_or(TopicSnapshot()), std::move(last)};
}

TopicSnapshot topics_now(const std::string& bus) {
  const StopSignals signals;
  bus::Subscriber subscriber(connect(bus_address(bus)));
  std::optional<TopicSnapshot> first;
  subscriber.on(topics::kTopics, [&](const wire::Topics& topics, const bus::Message&) {
    if (!first) first = read_topics(topics);
  });
  for (const Deadline deadline(5); !first && !deadline.passed() && !signals.stop().stop_requested();) {
    subscriber.dispatch_all(kPatience);
  }
  if (!first) throw std::runtime_error("the bus has said nothing of its topics for 5 s");
  return *first;
}

}  // namespace splatbus::cli
