#include "bus/liveness.h"

#include <algorithm>
#include <utility>

namespace splatbus::bus_service {
namespace {

constexpr std::int64_t silent_ns = 2'000'000'000;
constexpr std::int64_t forgotten_ns = 60'000'000'000;
constexpr std::size_t max_topics = 1024;
constexpr std::size_t max_names = 16;  // of sources and of schemas of a topic

void remember(std::set<std::string, std::less<>>& names, const flatbuffers::String& name) {
  if (names.size() < max_names && !names.contains(name.string_view())) names.insert(name.str());
}

void count(std::map<std::string, std::uint64_t, std::less<>>& messages, const flatbuffers::String& source) {
  auto found = messages.find(source.string_view());
  if (found == messages.end()) {
    if (messages.size() >= max_names) return;
    found = messages.emplace(source.str(), 0).first;
  }
  ++found->second;
}

}  // namespace

bool Liveness::has_room(const std::string& source, bool local) const {
  if (nodes_.contains(source)) return true;
  return nodes_.size() < kMaxNodes && (local || remote_ < kMaxRemoteNodes);
}

void Liveness::note(const wire::Heartbeat& heartbeat, std::int64_t now, bool local) {
  const auto source = heartbeat.header()->source()->str();
  if (!has_room(source, local)) return;
  auto& node = nodes_[source];
  if (!node.local) --remote_;
  if (!local) ++remote_;
  const bool alive =
      heartbeat.state() != wire::ServiceState::Stopping && heartbeat.state() != wire::ServiceState::Failed;
  changed_ =
      changed_ || node.alive != alive || node.state != heartbeat.state() || node.epoch != heartbeat.header()->epoch();
  node = {
      heartbeat.service()->str(), heartbeat.pid(), heartbeat.header()->epoch(), heartbeat.state(), now, alive, local};
}

/// Under another name: a successor that stood by as NAME.next is NAME from its takeover on.
bool Liveness::goes_on_elsewhere(const std::string& source, const Node& node) const {
  return !node.alive && std::ranges::any_of(nodes_, [&](const auto& other) {
    return other.first != source && other.second.alive && other.second.pid == node.pid &&
           other.second.service == node.service;
  });
}

std::vector<std::string> Liveness::update(std::int64_t now) {
  std::vector<std::string> forgotten;
  for (auto it = nodes_.begin(); it != nodes_.end();) {
    auto& node = it->second;
    if (node.alive && now - node.heard_ns > silent_ns) {
      node.alive = false;
      changed_ = true;
    }
    if (now - node.heard_ns > forgotten_ns || goes_on_elsewhere(it->first, node)) {
      forgotten.push_back(it->first);
      if (!node.local) --remote_;
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

void RunningSpread::add(std::int64_t value_ns) {
  const double value = static_cast<double>(value_ns) * 1e-9;
  ++count_;
  sum_s_ += value;
  squares_s2_ += value * value;
  least_s_ = recent_ == 0 ? value : std::min(least_s_, value);
  greatest_s_ = recent_ == 0 ? value : std::max(greatest_s_, value);
  ++recent_;
}

wire::Spread RunningSpread::take() {
  const bool any = std::exchange(recent_, 0) > 0;
  return {count_, sum_s_, squares_s2_, any ? least_s_ : 0, any ? greatest_s_ : 0};
}

void TopicTable::note(std::string_view name, const wire::Header& header, std::size_t body_bytes, std::int64_t now,
                      bool local) {
  auto found = topics_.find(name);
  if (found == topics_.end()) {
    if (topics_.size() >= max_topics) return;
    found = topics_.emplace(name, Topic()).first;
  }
  Topic& topic = found->second;
  remember(topic.schemas, *header.schema());
  count(topic.sources, *header.source());
  topic.latched = topic.latched || header.latch();
  if (topic.messages > 0) topic.intervals.add(now - topic.last_ns);
  topic.last_ns = now;
  if (local) {
    topic.transits.add(now - header.publish_ns());
    if (header.capture_ns() > 0) topic.ages.add(now - header.capture_ns());
  }
  ++topic.messages;
  topic.bytes += body_bytes;
  if (header.tensors() == nullptr) return;
  for (const wire::Tensor* tensor : *header.tensors()) {
    topic.bytes += tensor->span()->bytes();
    if (tensor->span()->storage() == wire::Storage::Slab) topic.shared_bytes += tensor->span()->bytes();
  }
}

}  // namespace splatbus::bus_service
