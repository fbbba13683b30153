#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <iterator>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <stdexcept>
#include <vector>

#include "bus/subscriber.h"
#include "bus_watch.h"
#include "launch_plan.h"
#include "node_info.h"
#include "schema_json.h"
#include "supervised_run.h"
#include "topic_watch.h"
#include "verbs.h"
#include "wire/system_generated.h"

namespace splatbus::cli {

namespace {

struct NodeOptions {
  std::string bus;
  double seconds = 1;
  std::string wait;                    ///< launch file whose services shall be there first
  std::vector<std::string> arguments;  ///< of that file
  double timeout_s = 60;
  bool json = false, counters = false;
};

/// Names that a sys/liveness message calls alive.
std::set<std::string> alive_nodes(const bus::Message& message) {
  std::set<std::string> alive;
  const auto& liveness = message.root<wire::Liveness>();
  if (liveness.nodes() == nullptr) return alive;
  for (const wire::Node* node : *liveness.nodes()) {
    if (node->alive()) alive.insert(node->source()->str());
  }
  return alive;
}

/// Until the broker calls every service of the file alive. Throws std::runtime_error that names those that are missing.
void wait_for_services(const NodeOptions& options, const std::shared_ptr<bus::Context>& context, const LaunchFile& file,
                       const StopSignals& signals) {
  const std::vector<std::string> wanted = heartbeat_sources(file);
  std::vector<std::string> missing = wanted;
  bus::Subscriber subscriber(context, {std::string(topics::kLiveness.name)});
  const std::int64_t end_ns = bus::now_ns() + static_cast<std::int64_t>(options.timeout_s * 1e9);
  while (!missing.empty()) {
    if (signals.stop().stop_requested()) throw std::runtime_error("interrupted");
    if (bus::now_ns() > end_ns) {
      throw std::runtime_error(fmt::format("not alive within {} s on {}: {}", options.timeout_s,
                                           context->address().text(), fmt::join(missing, ", ")));
    }
    const auto message = subscriber.receive(kPatience);
    if (!message) continue;
    bus::guarded(*message, [&] {
      const std::set<std::string> alive = alive_nodes(*message);
      missing.clear();
      std::copy_if(wanted.begin(), wanted.end(), std::back_inserter(missing),
                   [&](const std::string& name) { return !alive.contains(name); });
    });
  }
}

int list(const NodeOptions& options) {
  const StopSignals signals;
  std::optional<LaunchFile> file;
  if (!options.wait.empty()) file = read_launch_file(options.wait, parse_arguments(options.arguments));
  const bool own_bus = options.bus.empty() && file && file->bus;
  const auto address = own_bus ? bus::Address::parse(file->bus->value) : bus_address(options.bus);
  const auto context = file ? connect_later(address) : connect(address);
  if (file) wait_for_services(options, context, *file, signals);
  bus::Subscriber subscriber(context, {std::string(topics::kHeartbeat.name)});
  std::map<std::string, bus::Message> newest;
  const std::int64_t end_ns = bus::now_ns() + static_cast<std::int64_t>(options.seconds * 1e9);
  while (bus::now_ns() < end_ns && !signals.stop().stop_requested()) {
    if (auto message = subscriber.receive(kPatience)) {
      newest.insert_or_assign(message->header().source()->str(), std::move(*message));
    }
  }
  if (!options.json) {
    fmt::print("{:<18} {:<16} {:>8} {:<9} {:<7} {:>7}  {}\n", "SOURCE", "KIND", "PID", "STATE", "BACKEND", "AGE s",
               "DETAIL");
  }
  for (const auto& [source, message] : newest) {
    bus::guarded(message, [&message = message, &options] {
      const NodeState node = read_heartbeat(message.root<wire::Heartbeat>());
      if (options.json) {
        fmt::print("{}\n", json_text(to_json(node)));
        return;
      }
      fmt::print("{:<18} {:<16} {:>8} {:<9} {:<7} {:>7.2f}  {}\n", node.source, node.kind, node.pid, node.state,
                 node.backend, node.age_s, node.detail);
      if (!options.counters) return;
      for (const auto& [name, value] : node.counters) fmt::print("    {:<24} {:.6g}\n", name, value);
    });
  }
  if (newest.empty()) fmt::print(stderr, "splatbus node list: no heartbeat within {} s\n", options.seconds);
  return newest.empty() ? 1 : 0;
}

}  // namespace

void add_node_verb(CLI::App& app, Action& action) {
  CLI::App* node = app.add_subcommand("node", "Inspect the processes on the bus");
  node->require_subcommand(1);
  auto options = std::make_shared<NodeOptions>();
  CLI::App* verb = node->add_subcommand("list", "List processes with state, age and what they wait for");
  verb->add_option("--seconds", options->seconds, "time to listen, s (default 1)")->check(CLI::PositiveNumber);
  verb->add_flag("--json", options->json, "print JSON, one object per line, with counters and parameters");
  verb->add_flag("--counters", options->counters, "print the counters of each process below it");
  CLI::Option* const wait =
      verb->add_option("--wait", options->wait, "launch file: first wait until all of its services are alive");
  verb->add_option("arguments", options->arguments, "name=value: an argument of the launch file")->needs(wait);
  verb->add_option("--timeout", options->timeout_s, "longest wait for --wait, s (default 60)")
      ->check(CLI::PositiveNumber);
  add_bus_option(*verb, options->bus);
  verb->callback([options, &action] { action = [options] { return list(*options); }; });

  auto info_options = std::make_shared<NodeInfoOptions>();
  CLI::App* info = node->add_subcommand("info", "Show what a process publishes, reads, uses and is set to");
  info->add_option("name", info_options->name, "its name, or its kind where one process is of that kind")->required();
  info->add_flag("--json", info_options->json, "print one JSON object");
  add_bus_option(*info, info_options->bus);
  info->callback([info_options, &action] { action = [info_options] { return node_info(*info_options); }; });
}

}  // namespace splatbus::cli
