#include "bus/liveness.h"

#include <utility>

namespace splatbus::bus_service {
namespace {

constexpr std::int64_t silent_ns = 2'000'000'000;
constexpr std::int64_t forgotten_ns = 60'000'000'000;
constexpr std::size_t max_nodes = 1024;

}  // namespace

void Liveness::note(const wire::Heartbeat& heartbeat, std::int64_t now) {
  const auto source = heartbeat.header()->source()->str();
  if (nodes_.size() >= max_nodes && !nodes_.contains(source)) return;
  auto& node = nodes_[source];
  const bool alive =
      heartbeat.state() == wire::ServiceState::Starting || heartbeat.state() == wire::ServiceState::Running;
  changed_ = changed_ || node.alive != alive || node.state != heartbeat.state() ||
             node.epoch != heartbeat.header()->epoch() || node.heard_ns == 0;
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

}  // namespace splatbus::bus_service
