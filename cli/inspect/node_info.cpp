#include "node_info.h"

#include <fmt/format.h>

#include <stdexcept>
#include <vector>

#include "bus/nearest.h"
#include "control_request.h"
#include "control_socket.h"
#include "process_memory.h"
#include "schema_json.h"
#include "supervised_run.h"
#include "topic_watch.h"
#include "units_text.h"
#include "verbs.h"

namespace splatbus::cli {

namespace {

using Json = nlohmann::json;
constexpr double kPatienceS = 5, kSupervisorPatienceS = 2;

/// What the supervisor says of a process; null where there is none, it does not answer, or does not know that name.
Json supervised(const bus::Address& bus, const std::string& name) {
  try {
    const Json answer = ask_supervisor(bus, {{"verb", "status"}}, {}, kSupervisorPatienceS);
    for (const Json& process : answer.at("services")) {
      if (process.value("name", "") == name) return process;
    }
  } catch (const NoSupervisor&) {      // a bus may run without
  } catch (const SupervisorSilent&) {  // what the bus says is shown all the same
  }
  return nullptr;
}

Json collect(const NodeState& node, const TopicSnapshot& topics, const bus::Address& bus) {
  Json info = to_json(node);
  info["alive"] = node.alive;
  info["publishes"] = info["subscribes"] = Json::array();
  for (const auto& [topic, seen] : topics.topics) {
    if (seen.sources.contains(node.source)) {
      info["publishes"].push_back({{"topic", topic}, {"schemas", seen.schemas}, {"subscribers", seen.subscribers}});
    }
    if (seen.subscribers.contains(node.source)) {
      info["subscribes"].push_back({{"topic", topic}, {"schemas", seen.schemas}, {"publishers", seen.sources}});
    }
  }
  const auto or_null = [](const auto& value) { return value ? Json(*value) : Json(nullptr); };
  // A process elsewhere has a number that is another's here.
  const bool here = bus.is_local() && node.alive && node.pid != 0;
  info["memory_bytes"] = here ? or_null(resident_bytes(static_cast<pid_t>(node.pid))) : Json(nullptr);
  info["processor_s"] = here ? or_null(processor_seconds(static_cast<pid_t>(node.pid))) : Json(nullptr);
  const Json process = supervised(bus, node.source);
  for (const char* key : {"restarts", "uptime_s"}) {
    info[key] = process.is_object() && process.contains(key) ? process[key] : Json(nullptr);
  }
  return info;
}

std::string joined(const Json& names) {
  std::string text;
  for (const Json& name : names) {
    if (!text.empty()) text += ", ";
    text += name.get<std::string>();
  }
  return text.empty() ? "nobody" : text;
}

void print_text(const NodeState& node, const Json& info) {
  const auto line = [](const char* name, const std::string& text) { print(fmt::format("  {:<11} {}", name, text)); };
  const auto or_dash = [&](const char* key, const auto& text) {
    return info[key].is_null() ? std::string("-") : text(info[key].get<double>());
  };
  print(fmt::format("{}{}", node.source, node.kind == node.source ? "" : fmt::format(" ({})", node.kind)));
  line("state", fmt::format("{}{}{}", node.alive ? node.state : "gone",
                            node.alive || node.state == "Running" ? "" : ", " + node.state,
                            node.detail.empty() ? "" : ": " + node.detail));
  line("pid", std::to_string(node.pid));
  line("up", or_dash("uptime_s", duration_text));
  line("restarts", or_dash("restarts", [](double count) { return fmt::format("{:.0f}", count); }));
  line("backend", node.backend.empty() ? "-" : node.backend);
  line("protocol", std::to_string(node.protocol));
  line("memory", or_dash("memory_bytes", bytes_text));
  line("processor", or_dash("processor_s", [](double seconds) { return fmt::format("{:.1f} s", seconds); }));
  const auto topics = [&](const char* title, const char* others, const char* relation) {
    print(fmt::format("  {}", title));
    for (const Json& topic : info[title]) {
      print(fmt::format("    {:<24} {:<22} {} {}", topic["topic"].get<std::string>(), joined(topic["schemas"]),
                        relation, joined(topic[others])));
    }
  };
  topics("publishes", "subscribers", "to");
  topics("subscribes", "publishers", "from");
  print("  parameters");
  for (const auto& [name, value] : node.parameters) print(fmt::format("    {:<24} {}", name, value));
  print("  counters");
  for (const auto& [name, value] : node.counters) print(fmt::format("    {:<24} {:.6g}", name, value));
}

}  // namespace

std::string find_node(const std::map<std::string, NodeState>& nodes, const std::string& name) {
  if (nodes.contains(name)) return name;
  std::vector<std::string> sources, of_kind;
  for (const auto& [source, node] : nodes) {
    sources.push_back(source);
    if (node.kind == name) of_kind.push_back(source);
  }
  if (of_kind.size() == 1) return of_kind.front();
  const std::string known = of_kind.empty() ? bus::suggestion(name, sources) : bus::suggestion("", of_kind);
  throw std::runtime_error(fmt::format("{} '{}' on this bus{}",
                                       of_kind.empty() ? "no process" : "several processes are of kind", name, known));
}

int node_info(const NodeInfoOptions& options) {
  const StopSignals signals;
  const bus::Address address = bus_address(options.bus);
  BusWatch watch(connect(address));
  for (const Deadline deadline(kPatienceS); !watch.complete() && !deadline.passed();) {
    if (signals.stop().stop_requested()) return 1;
    watch.follow(kPatience);
  }
  if (!watch.complete()) throw std::runtime_error(fmt::format("the bus has said nothing for {} s", kPatienceS));
  const NodeState& node = watch.nodes().at(find_node(watch.nodes(), options.name));
  const Json info = collect(node, *watch.topics(), address);
  if (options.json) {
    print(json_text(info));
  } else {
    print_text(node, info);
  }
  return 0;
}

}  // namespace splatbus::cli
