#include "bus_watch.h"

#include <array>
#include <utility>

#include "bus/clock.h"
#include "wire/system_generated.h"
#include "wire/topics.h"

namespace splatbus::cli {

namespace {

std::string text_of(const flatbuffers::String* string) {
  return string != nullptr ? string->str() : std::string();
}

}  // namespace

NodeState read_heartbeat(const wire::Heartbeat& heartbeat) {
  NodeState node{
      .source = heartbeat.header()->source()->str(),
      .kind = heartbeat.service()->str(),
      .state = wire::EnumNameServiceState(heartbeat.state()),
      .detail = text_of(heartbeat.detail()),
      .backend = text_of(heartbeat.backend()),
      .pid = heartbeat.pid(),
      .protocol = heartbeat.protocol(),
      .alive = heartbeat.state() != wire::ServiceState::Stopping && heartbeat.state() != wire::ServiceState::Failed,
      .age_s = static_cast<double>(bus::now_ns() - heartbeat.header()->publish_ns()) / 1e9};
  if (heartbeat.counters() != nullptr) {
    for (const auto* counter : *heartbeat.counters()) node.counters[counter->name()->str()] = counter->value();
  }
  if (heartbeat.parameters() != nullptr) {
    for (const auto* entry : *heartbeat.parameters()) node.parameters[entry->key()->str()] = entry->value()->str();
  }
  return node;
}

nlohmann::json to_json(const NodeState& node) {
  return {{"source", node.source},        {"kind", node.kind},         {"pid", node.pid},
          {"state", node.state},          {"backend", node.backend},   {"detail", node.detail},
          {"age_s", node.age_s},          {"protocol", node.protocol}, {"counters", node.counters},
          {"parameters", node.parameters}};
}

double drops_of(const NodeState& node) {
  constexpr std::array<std::string_view, 3> kWords{"lost", "dropped", "malformed"};
  double sum = 0;
  for (const auto& [name, value] : node.counters) {
    if (name.starts_with("samples_")) continue;
    for (const std::string_view word : kWords) {
      if (name.find(word) == std::string::npos) continue;
      sum += value;
      break;
    }
  }
  return sum;
}

BusWatch::BusWatch(std::shared_ptr<bus::Context> context) : subscriber_(std::move(context)) {
  subscriber_
      .on(topics::kHeartbeat,
          [this](const wire::Heartbeat& heartbeat, const bus::Message&) {
            NodeState node = read_heartbeat(heartbeat);
            nodes_[node.source] = std::move(node);
          })
      .on(topics::kLiveness, [this](const wire::Liveness& liveness, const bus::Message&) { take(liveness); })
      .on(topics::kTopics, [this](const wire::Topics& topics, const bus::Message&) {
        topics_before_ = std::move(topics_);
        topics_ = read_topics(topics);
      });
}

void BusWatch::follow(std::chrono::milliseconds time) {
  for (const auto end = std::chrono::steady_clock::now() + time;;) {
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(end - std::chrono::steady_clock::now());
    if (left.count() <= 0) return;
    subscriber_.dispatch_all(left);
  }
}

void BusWatch::take(const wire::Liveness& liveness) {
  heard_liveness_ = true;
  std::map<std::string, bool> alive{{"bus", true}};  // says so by speaking
  if (liveness.nodes() != nullptr) {
    for (const wire::Node* node : *liveness.nodes()) alive[node->source()->str()] = node->alive();
  }
  std::erase_if(nodes_, [&](const auto& entry) { return !alive.contains(entry.first); });
  for (auto& [source, node] : nodes_) node.alive = alive[source];
}

}  // namespace splatbus::cli
