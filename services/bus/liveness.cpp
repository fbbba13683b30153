#include "bus/liveness.h"

#include <utility>

namespace splatbus::bus_service {
namespace {

constexpr std::int64_t silent_ns = 2'000'000'000;
constexpr std::int64_t forgotten_ns = 60'000'000'000;
constexpr std::size_t max_nodes = 1024;
constexpr std::size_t max_topics = 1024;
constexpr std::size_t max_names = 16;  // of sources and of schemas of a topic

void remember(std::set<std::string>& names, const flatbuffers::String& name) {
  if (names.size() < max_names) names.insert(name.str());
}

}  // namespace

void Liveness::note(const wire::Heartbeat& heartbeat, std::int64_t now) {
  const auto source = heartbeat.header()->source()->str();
  if (nodes_.size() >= max_nodes && !nodes_.contains(source)) return;
  auto& node = nodes_[source];
  const bool alive =
      heartbeat.state() != wire::ServiceState::Stopping && heartbeat.state() != wire::ServiceState::Failed;
  changed_ =
      changed_ || node.alive != alive || node.state != heartbeat.state() || node.epoch != heartbeat.header()->epoch();
  node = {heartbeat.service()->str(), heartbeat.pid(), heartbeat.header()->epoch(), heartbeat.state(), now, alive};
}

std::vector<std::string> Liveness::update(std::int64_t now) {
  std::vector<std::string> forgotten;
  for (auto it = nodes_.begin(); it != nodes_.end();) {
    auto& node = it->second;
    if (node.alive && now - node.heard_ns > silent_ns) {
      node.alive = false;
      changed_ = true;
    }
    if (now - node.heard_ns > forgotten_ns) {
      forgotten.push_back(it->first);
      it = nodes_.erase(it);
      changed_ = true;
    } else {
      ++it;
    }
  }
  return forgotten;
}

bool Liveness::take_changed() {
  return std::exchange(changed_, false);
}

void TopicTable::note(std::string_view name, const wire::Header& header, std::size_t body_bytes) {
  auto found = topics_.find(name);
  if (found == topics_.end()) {
    if (topics_.size() >= max_topics) return;
    found = topics_.emplace(name, Topic()).first;
  }
  Topic& topic = found->second;
  remember(topic.schemas, *header.schema());
  remember(topic.sources, *header.source());
  topic.latched = topic.latched || header.latch();
  ++topic.messages;
  topic.bytes += body_bytes;
  if (header.tensors() == nullptr) return;
  for (const wire::Tensor* tensor : *header.tensors()) topic.bytes += tensor->span()->bytes();
}

}  // namespace splatbus::bus_service
