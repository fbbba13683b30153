#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <set>
#include <string>

#include "bus/broker.h"
#include "bus/frames.h"
#include "bus/liveness.h"

namespace splatbus::bus_service {

/// The broker's name where it publishes itself.
inline constexpr const char* own_source = "bus";

/// What the broker itself says, as source "bus": its heartbeat, sys/liveness and sys/topics.
class OwnMessages {
 public:
  OwnMessages();

  bus::Frames heartbeat(const BrokerStatistics& statistics, wire::ServiceState state);
  bus::Frames liveness(const std::map<std::string, Liveness::Node>& nodes);
  /// Who reads a topic.
  using Readers = std::function<std::set<std::string>(const std::string& topic)>;
  /// Begins the table's least and greatest values anew.
  bus::Frames topics(TopicTable& table, const Readers& readers);

 private:
  flatbuffers::Offset<wire::Header> header(flatbuffers::FlatBufferBuilder& builder, std::string_view schema,
                                           std::uint64_t sequence) const;

  const std::uint64_t epoch_;
  std::uint64_t heartbeats_ = 0;
  std::uint64_t liveness_messages_ = 0;
  std::uint64_t topics_messages_ = 0;
};

}  // namespace splatbus::bus_service
