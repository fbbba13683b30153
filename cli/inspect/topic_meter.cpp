#include <fmt/format.h>
#include <fmt/ranges.h>

#include <nlohmann/json.hpp>
#include <set>
#include <utility>
#include <vector>

#include "schema_json.h"
#include "topic_verbs.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::json;

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

const char* name_of(Meter meter) {
  if (meter == Meter::Rate) return "hz";
  return meter == Meter::Bandwidth ? "bw" : "delay";
}

std::string meter_head(Meter meter) {
  constexpr const char* kSpread = "  MEAN ms     LEAST  GREATEST DEVIATION";
  if (meter == Meter::Rate) return fmt::format("{:<24} {:>10} {}", "TOPIC", "HZ", kSpread);
  if (meter == Meter::Bandwidth) return fmt::format("{:<24} {:>10} {:>14}", "TOPIC", "WIRE Mb/s", "SHARED Mb/s");
  return fmt::format("{:<24} {:<39} {}\n{:<24} {} {}", "", "PUBLISHED TO BUS", "CAPTURED TO BUS", "TOPIC", kSpread,
                     kSpread);
}

}  // namespace

int list_topics(const TopicOptions& options) {
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

/// Once a second: what passed of every topic in that second. Names asked for that nobody has published are named too.
int meter_topics(const TopicOptions& options, Meter meter) {
  bool heard = false, named = false;
  if (!options.json) print(meter_head(meter));
  follow_topics(options, [&](const TopicSnapshot& before, const TopicSnapshot& after) {
    if (!std::exchange(named, true)) {
      std::vector<std::string> there;
      for (const auto& [topic, seen] : after.topics) there.push_back(topic);
      name_absent(name_of(meter), options, there);
    }
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

}  // namespace splatbus::cli
