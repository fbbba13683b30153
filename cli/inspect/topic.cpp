#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <functional>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>
#include <vector>

#include "schema_json.h"
#include "supervised_run.h"
#include "topic_statistics.h"
#include "verbs.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::json;
constexpr std::chrono::milliseconds kPatience(50);

struct TopicOptions {
  std::string bus;
  std::vector<std::string> topics{"*"};
  double seconds = 0;
  std::uint64_t count = 0;
  bool json = false;
};

/// A deadline that 0 seconds means never.
class Deadline {
 public:
  explicit Deadline(double seconds)
      : end_ns_(seconds > 0 ? bus::now_ns() + static_cast<std::int64_t>(seconds * 1e9) : 0) {}
  [[nodiscard]] bool passed() const { return end_ns_ != 0 && bus::now_ns() >= end_ns_; }

 private:
  std::int64_t end_ns_;
};

void print(const std::string& text) {
  fmt::print("{}\n", text);
  std::fflush(stdout);
}

/// Follows sys/topics for as long as the options say: `each(before, after)` for each one and the one before it. Returns
/// the first and the last. No message of another topic comes here.
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

int list(const TopicOptions& options) {
  const auto [first, last] = follow_topics(options, [](const TopicSnapshot&, const TopicSnapshot&) {});
  if (!options.json) print(fmt::format("{:<24} {:>8} {:>8}  {:<22} {}", "TOPIC", "MESSAGES", "HZ", "SCHEMA", "SOURCE"));
  for (const auto& [topic, seen] : last.topics) {
    const double rate_hz = traffic_between(first, last, topic).rate_hz;
    if (options.json) {
      print(json_text({{"topic", topic},
                       {"messages", seen.messages},
                       {"rate_hz", rate_hz},
                       {"schemas", seen.schemas},
                       {"sources", seen.sources},
                       {"latched", seen.latched}}));
    } else {
      print(fmt::format("{:<24} {:>8} {:>8.2f}  {:<22} {}{}", topic, seen.messages, rate_hz,
                        fmt::join(seen.schemas, ","), fmt::join(seen.sources, ","), seen.latched ? " (latched)" : ""));
    }
  }
  if (last.topics.empty()) fmt::print(stderr, "splatbus topic list: nothing arrived within {} s\n", options.seconds);
  return last.topics.empty() ? 1 : 0;
}

int echo(const TopicOptions& options) {
  const StopSignals signals;
  bus::Subscriber subscriber(connect(bus_address(options.bus)), options.topics);
  SchemaJson schemas;
  std::uint64_t shown = 0;
  for (const Deadline deadline(options.seconds); !deadline.passed() && !signals.stop().stop_requested();) {
    const auto message = subscriber.receive(kPatience);
    if (!message) continue;
    try {
      const Json body = schemas.to_json(*message);
      const Json json{{"topic", message->topic()}, {"message", body}};
      print(options.json ? json_text(json) : fmt::format("--- {}\n{}", message->topic(), json_text(body, 2)));
    } catch (const bus::Error& error) {
      fmt::print(stderr, "splatbus topic echo: {}\n", error.what());
      continue;
    }
    if (++shown == options.count) return 0;
  }
  return options.count > 0 ? 1 : 0;
}

bool is_asked_for(const TopicOptions& options, const std::string& topic) {
  return std::any_of(options.topics.begin(), options.topics.end(), [&](const std::string& asked) {
    return asked.ends_with('*') ? topic.starts_with(asked.substr(0, asked.size() - 1)) : topic == asked;
  });
}

/// Once a second: rate or bandwidth of every topic that was heard in that second.
int meter(const TopicOptions& options, bool bandwidth) {
  bool heard = false;
  follow_topics(options, [&](const TopicSnapshot& before, const TopicSnapshot& after) {
    for (const auto& [topic, seen] : after.topics) {
      const TopicTraffic traffic = traffic_between(before, after, topic);
      if (traffic.messages == 0 || !is_asked_for(options, topic)) continue;
      if (options.json) {
        print(json_text({{"topic", topic}, {"rate_hz", traffic.rate_hz}, {"mbps", traffic.megabits_per_s}}));
      } else if (bandwidth) {
        print(fmt::format("{:<24} {:>10.3f} Mbit/s", topic, traffic.megabits_per_s));
      } else {
        print(fmt::format("{:<24} {:>10.2f} Hz", topic, traffic.rate_hz));
      }
      heard = true;
    }
  });
  return heard ? 0 : 1;
}

CLI::App* add_verb(CLI::App& parent, const std::string& name, const std::string& text,
                   const std::shared_ptr<TopicOptions>& options, const std::string& seconds_text) {
  CLI::App* verb = parent.add_subcommand(name, text);
  verb->add_option("--seconds", options->seconds, seconds_text)->check(CLI::NonNegativeNumber);
  verb->add_flag("--json", options->json, "one JSON object a line");
  add_bus_option(*verb, options->bus);
  return verb;
}

}  // namespace

void add_topic_verb(CLI::App& app, Action& action) {
  CLI::App* topic = app.add_subcommand("topic", "Look at what crosses the bus");
  topic->require_subcommand(1);
  constexpr const char* kForever = "how long; 0: until Ctrl-C";
  constexpr const char* kTopics = "topics; a name that ends in * is a prefix (default: all)";

  auto list_options = std::make_shared<TopicOptions>();
  list_options->seconds = 2;
  CLI::App* list_verb = add_verb(*topic, "list", "Topics since the broker started, with schema, source and rate",
                                 list_options, "how long to listen (default 2)");
  list_verb->callback([list_options, &action] { action = [list_options] { return list(*list_options); }; });

  auto echo_options = std::make_shared<TopicOptions>();
  CLI::App* echo_verb = add_verb(*topic, "echo", "Print messages as JSON, tensors summarised", echo_options, kForever);
  echo_verb->add_option("topic", echo_options->topics, kTopics);
  echo_verb->add_option("-n,--count", echo_options->count, "stop after that many messages; 0: no limit");
  echo_verb->callback([echo_options, &action] { action = [echo_options] { return echo(*echo_options); }; });

  for (const bool bandwidth : {false, true}) {
    auto options = std::make_shared<TopicOptions>();
    CLI::App* verb = bandwidth ? add_verb(*topic, "bw", "Bandwidth, tensors included, once a second", options, kForever)
                               : add_verb(*topic, "hz", "Rates, once a second", options, kForever);
    verb->add_option("topic", options->topics, kTopics);
    verb->callback(
        [options, bandwidth, &action] { action = [options, bandwidth] { return meter(*options, bandwidth); }; });
  }
}

}  // namespace splatbus::cli
