#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "wire/system_generated.h"

namespace splatbus::bus_service {

/// Who is alive, from the heartbeats that pass. Times are CLOCK_MONOTONIC of the broker.
class Liveness {
 public:
  struct Node {
    std::string service;
    std::uint32_t pid = 0;
    std::uint64_t epoch = 0;
    wire::ServiceState state = wire::ServiceState::Starting;
    std::int64_t heard_ns = 0;
    bool alive = false;
    bool local = true;
  };
  static constexpr std::size_t kMaxNodes = 1024, kMaxRemoteNodes = 512;

  /// One that heartbeat_problem() finds nothing wrong with, of a source of this machine or not. Of more sources than
  /// there may be, it keeps the first, and places for those of this machine.
  void note(const wire::Heartbeat& heartbeat, std::int64_t now, bool local = true);

  /// Marks the silent as gone; returns the sources that leave the list: gone for long, or of a process that goes on
  /// under another name.
  std::vector<std::string> update(std::int64_t now);

  /// True once after something else than an age changed.
  bool take_changed();

  [[nodiscard]] const std::map<std::string, Node>& nodes() const { return nodes_; }

 private:
  [[nodiscard]] bool has_room(const std::string& source, bool local) const;
  [[nodiscard]] bool goes_on_elsewhere(const std::string& source, const Node& node) const;

  std::map<std::string, Node> nodes_;
  std::size_t remote_ = 0;  ///< of nodes_
  bool changed_ = false;
};

/// wire::Spread, while it grows.
class RunningSpread {
 public:
  void add(std::int64_t value_ns);
  /// Begins the least and the greatest anew.
  [[nodiscard]] wire::Spread take();

 private:
  std::uint64_t count_ = 0, recent_ = 0;
  double sum_s_ = 0, squares_s2_ = 0, least_s_ = 0, greatest_s_ = 0;
};

/// What has passed of each topic, for sys/topics.
class TopicTable {
 public:
  struct Topic {
    std::set<std::string, std::less<>> schemas;
    std::map<std::string, std::uint64_t, std::less<>> sources;  ///< messages of each
    bool latched = false;
    std::uint64_t messages = 0;
    std::uint64_t bytes = 0;         ///< with the tensors that they announce
    std::uint64_t shared_bytes = 0;  ///< of tensors in slabs
    std::int64_t last_ns = 0;
    RunningSpread intervals, transits, ages;
  };

  /// A message whose body has `body_bytes`, at `now`. What goes beyond the bounds that schemas/system.fbs names is left
  /// out, and so is how old it is where it is not `local`: clocks of other machines do not compare.
  void note(std::string_view topic, const wire::Header& header, std::size_t body_bytes, std::int64_t now, bool local);

  [[nodiscard]] const std::map<std::string, Topic, std::less<>>& topics() const { return topics_; }
  [[nodiscard]] std::map<std::string, Topic, std::less<>>& topics() { return topics_; }

 private:
  std::map<std::string, Topic, std::less<>> topics_;
};

}  // namespace splatbus::bus_service
