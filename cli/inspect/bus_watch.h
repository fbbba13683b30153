#pragma once

#include <chrono>
#include <cstdint>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "bus/subscriber.h"
#include "topic_statistics.h"

namespace splatbus::cli {

/// What a process says of itself in its heartbeats.
struct NodeState {
  std::string source, kind, state, detail, backend;  ///< of `backend` empty: it has none
  std::uint32_t pid = 0, protocol = 0;
  bool alive = false;
  double age_s = 0;  ///< since the heartbeat was published
  std::map<std::string, double> counters;
  std::map<std::string, std::string> parameters;
};

[[nodiscard]] NodeState read_heartbeat(const wire::Heartbeat& heartbeat);
[[nodiscard]] nlohmann::json to_json(const NodeState& node);

/// What is lost on the way: the sum of a process's counters whose names speak of loss. Samples beyond a budget are left
/// out on purpose, and do not count.
[[nodiscard]] double drops_of(const NodeState& node);

/// Follows sys/heartbeat, sys/liveness and sys/topics, and nothing else. One thread.
class BusWatch {
 public:
  explicit BusWatch(std::shared_ptr<bus::Context> context);

  /// Takes what comes within that time.
  void follow(std::chrono::milliseconds time);
  /// True once each of the three has come.
  [[nodiscard]] bool complete() const { return !nodes_.empty() && heard_liveness_ && topics_.has_value(); }

  /// By source. Those that the broker has forgotten are left out.
  [[nodiscard]] const std::map<std::string, NodeState>& nodes() const { return nodes_; }
  /// The newest, and the one before it.
  [[nodiscard]] const std::optional<TopicSnapshot>& topics() const { return topics_; }
  [[nodiscard]] const std::optional<TopicSnapshot>& topics_before() const { return topics_before_; }

 private:
  void take(const wire::Liveness& liveness);

  bus::Subscriber subscriber_;
  std::map<std::string, NodeState> nodes_;
  bool heard_liveness_ = false;
  std::optional<TopicSnapshot> topics_, topics_before_;
};

}  // namespace splatbus::cli
