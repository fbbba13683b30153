#include <fmt/format.h>

#include <chrono>
#include <map>
#include <nlohmann/json.hpp>

#include "bus/subscriber.h"
#include "json_text.h"
#include "stop_signals.h"
#include "verbs.h"
#include "wire/system_generated.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::json;
constexpr std::chrono::milliseconds kPatience(50);

struct NodeOptions {
  std::string bus;
  double seconds = 1;
  bool json = false;
};

Json describe(const wire::Heartbeat& heartbeat) {
  const auto text = [](const flatbuffers::String* string) { return string != nullptr ? string->str() : std::string(); };
  Json node{{"source", heartbeat.header()->source()->str()},
            {"kind", heartbeat.service()->str()},
            {"pid", heartbeat.pid()},
            {"state", wire::EnumNameServiceState(heartbeat.state())},
            {"detail", text(heartbeat.detail())},
            {"age_s", static_cast<double>(bus::now_ns() - heartbeat.header()->publish_ns()) / 1e9},
            {"counters", Json::object()},
            {"parameters", Json::object()}};
  if (heartbeat.counters() != nullptr) {
    for (const auto* counter : *heartbeat.counters()) node["counters"][counter->name()->str()] = counter->value();
  }
  if (heartbeat.parameters() != nullptr) {
    for (const auto* entry : *heartbeat.parameters()) node["parameters"][entry->key()->str()] = entry->value()->str();
  }
  return node;
}

int list(const NodeOptions& options) {
  const StopSignals signals;
  bus::Subscriber subscriber(connect(bus_address(options.bus)), {"sys/heartbeat"});
  std::map<std::string, bus::Message> newest;
  const std::int64_t end_ns = bus::now_ns() + static_cast<std::int64_t>(options.seconds * 1e9);
  while (bus::now_ns() < end_ns && !signals.stop().stop_requested()) {
    if (auto message = subscriber.receive(kPatience)) {
      newest.insert_or_assign(message->header().source()->str(), std::move(*message));
    }
  }
  if (!options.json) {
    fmt::print("{:<18} {:<16} {:>8} {:<9} {:>7}  {}\n", "SOURCE", "KIND", "PID", "STATE", "AGE s", "COUNTERS");
  }
  for (const auto& [source, message] : newest) {
    bus::guarded(message, [&message = message, &options] {
      const Json node = describe(message.root<wire::Heartbeat>("Heartbeat/1"));
      if (options.json) return fmt::print("{}\n", json_text(node));
      std::string counters = node["detail"];
      for (const auto& [name, value] : node["counters"].items()) {
        counters +=
            fmt::format("{}{}={:.6g}", counters.empty() ? "" : " ", name, value.is_null() ? 0.0 : value.get<double>());
      }
      fmt::print("{:<18} {:<16} {:>8} {:<9} {:>7.2f}  {}\n", node["source"].get<std::string>(),
                 node["kind"].get<std::string>(), node["pid"].get<int>(), node["state"].get<std::string>(),
                 node["age_s"].get<double>(), counters);
    });
  }
  if (newest.empty()) fmt::print(stderr, "splatbus node list: no heartbeat within {} s\n", options.seconds);
  return newest.empty() ? 1 : 0;
}

}  // namespace

void add_node_verb(CLI::App& app, Action& action) {
  CLI::App* node = app.add_subcommand("node", "Look at the processes on the bus");
  node->require_subcommand(1);
  auto options = std::make_shared<NodeOptions>();
  CLI::App* verb = node->add_subcommand("list", "Processes that send heartbeats, with state, age and counters");
  verb->add_option("--seconds", options->seconds, "how long to listen (default 1)")->check(CLI::PositiveNumber);
  verb->add_flag("--json", options->json, "one JSON object a line");
  add_bus_option(*verb, options->bus);
  verb->callback([options, &action] { action = [options] { return list(*options); }; });
}

}  // namespace splatbus::cli
