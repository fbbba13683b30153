#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <functional>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <stdexcept>
#include <tuple>
#include <utility>
#include <vector>

#include "message_filter.h"
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
  bool json = false, once = false, csv = false;
  std::vector<std::string> fields;
  std::string filter;
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
  if (options.csv && options.fields.empty()) throw std::runtime_error("--csv needs --field, once for each column");
  const std::uint64_t wanted = options.once ? 1 : options.count;
  std::optional<MessageFilter> filter;
  if (!options.filter.empty()) filter.emplace(options.filter);
  bus::Subscriber subscriber(connect(bus_address(options.bus)), options.topics);
  SchemaJson schemas;
  std::uint64_t shown = 0;
  for (const Deadline deadline(options.seconds); !deadline.passed() && !signals.stop().stop_requested();) {
    const auto message = subscriber.receive(kPatience);
    if (!message) continue;
    try {
      const Json body = schemas.to_json(*message);
      if (filter && !filter->holds(body)) continue;
      if (options.csv) {
        if (shown == 0) print(csv_line(options.fields));
        print(csv_line(values_of(body, options.fields)));
      } else if (!options.fields.empty()) {
        print(fmt::format("{}", fmt::join(values_of(body, options.fields), " ")));
      } else {
        const Json json{{"topic", message->topic()}, {"message", body}};
        print(options.json ? json_text(json) : fmt::format("--- {}\n{}", message->topic(), json_text(body, 2)));
      }
    } catch (const bus::Error& error) {
      fmt::print(stderr, "splatbus topic echo: {}\n", error.what());
      continue;
    }
    if (++shown == wanted) return 0;
  }
  return wanted > 0 ? 1 : 0;
}

bool is_asked_for(const TopicOptions& options, const std::string& topic) {
  return std::any_of(options.topics.begin(), options.topics.end(), [&](const std::string& asked) {
    return asked.ends_with('*') ? topic.starts_with(asked.substr(0, asked.size() - 1)) : topic == asked;
  });
}

enum class Meter : std::uint8_t { Rate, Bandwidth, Delay };

Json in_json(const Summary& summary) {
  return {{"count", summary.count},
          {"mean_s", summary.mean_s},
          {"deviation_s", summary.deviation_s},
          {"least_s", summary.least_s},
          {"greatest_s", summary.greatest_s}};
}

std::string in_ms(const Summary& summary) {
  if (summary.count == 0) return fmt::format("{:>9} {:>9} {:>9} {:>9}", "-", "-", "-", "-");
  return fmt::format("{:>9.2f} {:>9.2f} {:>9.2f} {:>9.2f}", summary.mean_s * 1e3, summary.least_s * 1e3,
                     summary.greatest_s * 1e3, summary.deviation_s * 1e3);
}

std::string meter_line(const std::string& topic, const TopicTraffic& traffic, const TopicOptions& options,
                       Meter meter) {
  if (options.json) {
    return json_text({{"topic", topic},
                      {"messages", traffic.messages},
                      {"rate_hz", traffic.rate_hz},
                      {"mbps", traffic.megabits_per_s},
                      {"shared_mbps", traffic.shared_megabits_per_s},
                      {"interval", in_json(traffic.intervals)},
                      {"transit", in_json(traffic.transits)},
                      {"age", in_json(traffic.ages)}});
  }
  if (traffic.messages == 0) return fmt::format("{:<24} {:>10}", topic, "silent");
  if (meter == Meter::Rate) return fmt::format("{:<24} {:>10.2f} {}", topic, traffic.rate_hz, in_ms(traffic.intervals));
  if (meter == Meter::Delay) return fmt::format("{:<24} {} {}", topic, in_ms(traffic.transits), in_ms(traffic.ages));
  return fmt::format("{:<24} {:>10.3f} {:>14.3f}", topic, traffic.megabits_per_s, traffic.shared_megabits_per_s);
}

std::string meter_head(Meter meter) {
  constexpr const char* kSpread = "  MEAN ms     LEAST  GREATEST DEVIATION";
  if (meter == Meter::Rate) return fmt::format("{:<24} {:>10} {}", "TOPIC", "HZ", kSpread);
  if (meter == Meter::Bandwidth) return fmt::format("{:<24} {:>10} {:>14}", "TOPIC", "WIRE Mb/s", "SHARED Mb/s");
  return fmt::format("{:<24} {:<39} {}\n{:<24} {} {}", "", "PUBLISHED TO BUS", "CAPTURED TO BUS", "TOPIC", kSpread,
                     kSpread);
}

/// Once a second: what passed of every topic in that second. Names asked for that nobody has published are named too.
int meter(const TopicOptions& options, Meter meter) {
  bool heard = false;
  if (!options.json) print(meter_head(meter));
  follow_topics(options, [&](const TopicSnapshot& before, const TopicSnapshot& after) {
    std::set<std::string> names;
    for (const auto& [topic, seen] : after.topics) {
      if (is_asked_for(options, topic)) names.insert(topic);
    }
    for (const std::string& asked : options.topics) {
      if (!asked.ends_with('*')) names.insert(asked);
    }
    for (const std::string& topic : names) {
      const TopicTraffic traffic = traffic_between(before, after, topic);
      print(meter_line(topic, traffic, options, meter));
      heard = heard || traffic.messages > 0;
    }
  });
  return heard ? 0 : 1;
}

/// The first sys/topics, which the broker holds for those who come.
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

int info(const TopicOptions& options) {
  const TopicSnapshot now = topics_now(options.bus);
  bool found = false;
  for (const auto& [topic, seen] : now.topics) {
    if (!is_asked_for(options, topic)) continue;
    found = true;
    if (options.json) {
      print(json_text({{"topic", topic},
                       {"schemas", seen.schemas},
                       {"publishers", seen.sources},
                       {"subscribers", seen.subscribers},
                       {"latched", seen.latched},
                       {"messages", seen.messages},
                       {"bytes", seen.bytes},
                       {"shared_bytes", seen.shared_bytes}}));
      continue;
    }
    print(fmt::format(
        "{}\n  schema       {}\n  publishers   {}\n  subscribers  {}\n  latched      {}\n"
        "  messages     {}, {} bytes on sockets and {} in shared memory",
        topic, fmt::join(seen.schemas, ", "), fmt::join(seen.sources, ", "), fmt::join(seen.subscribers, ", "),
        seen.latched ? "yes" : "no", seen.messages, seen.bytes - seen.shared_bytes, seen.shared_bytes));
  }
  if (!found) fmt::print(stderr, "splatbus topic info: nobody has published {}\n", fmt::join(options.topics, ", "));
  return found ? 0 : 1;
}

int graph(const TopicOptions& options, bool dot) {
  const TopicSnapshot now = topics_now(options.bus);
  if (dot) print("digraph splatbus {\n  rankdir=LR;");
  for (const auto& [topic, seen] : now.topics) {
    if (!is_asked_for(options, topic)) continue;
    if (!dot) {
      print(fmt::format("{} -> {} -> {}", fmt::join(seen.sources, ", "), topic,
                        seen.subscribers.empty() ? "nobody" : fmt::format("{}", fmt::join(seen.subscribers, ", "))));
      continue;
    }
    // Json(text).dump() quotes as DOT does; a topic and a source may have one name.
    const auto quoted = [](const std::string& text) { return json_text(Json(text)); };
    print(fmt::format("  {} [shape=box];", quoted("/" + topic)));
    for (const auto& source : seen.sources) print(fmt::format("  {} -> {};", quoted(source), quoted("/" + topic)));
    for (const auto& reader : seen.subscribers) print(fmt::format("  {} -> {};", quoted("/" + topic), quoted(reader)));
  }
  if (dot) print("}");
  return 0;
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

  echo_verb->add_flag("--once", echo_options->once, "print one message and exit");
  echo_verb->add_option("--field", echo_options->fields,
                        "print this field alone, as scene.light.generation; repeatable");
  echo_verb->add_option(
      "--filter", echo_options->filter,
      "print messages for which this holds: FIELD OP VALUE, joined by &&; OP is ==, !=, <, <=, > or >=");
  echo_verb->add_flag("--csv", echo_options->csv, "print the fields as CSV with a header line");

  const std::tuple<const char*, const char*, Meter> meters[] = {
      {"hz", "Measure rates and intervals once a second; silent topics are named", Meter::Rate},
      {"bw", "Measure bandwidth once a second, sockets and shared memory apart", Meter::Bandwidth},
      {"delay", "Measure how old messages are when they reach the bus", Meter::Delay}};
  for (const auto& [name, text, kind] : meters) {
    auto options = std::make_shared<TopicOptions>();
    CLI::App* verb = add_verb(*topic, name, text, options, kForever);
    verb->add_option("topic", options->topics, kTopics);
    verb->callback([options, kind = kind, &action] { action = [options, kind] { return meter(*options, kind); }; });
  }

  auto info_options = std::make_shared<TopicOptions>();
  CLI::App* info_verb = topic->add_subcommand("info", "Show schema, publishers and subscribers of topics");
  info_verb->add_option("topic", info_options->topics, kTopics);
  info_verb->add_flag("--json", info_options->json, "one JSON object a line");
  add_bus_option(*info_verb, info_options->bus);
  info_verb->callback([info_options, &action] { action = [info_options] { return info(*info_options); }; });

  auto graph_options = std::make_shared<TopicOptions>();
  auto dot = std::make_shared<bool>(false);
  CLI::App* graph_verb = app.add_subcommand("graph", "Show who publishes and who reads each topic");
  graph_verb->add_option("topic", graph_options->topics, kTopics);
  graph_verb->add_flag("--dot", *dot, "print the graph in the DOT language of Graphviz");
  add_bus_option(*graph_verb, graph_options->bus);
  graph_verb->callback(
      [graph_options, dot, &action] { action = [graph_options, dot] { return graph(*graph_options, *dot); }; });
}

}  // namespace splatbus::cli
