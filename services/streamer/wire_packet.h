#pragma once

#include <cstddef>
#include <memory>
#include <zmq.hpp>

#include "stream/packets.h"

namespace splatbus::streamer {

/// A packet in ZeroMQ's own, counted memory: sent to any number of viewers without a copy of its payload.
class WirePacket {
 public:
  explicit WirePacket(const stream::EncodedPacket& packet);

  [[nodiscard]] wire::Body body() const { return body_; }
  [[nodiscard]] std::size_t bytes() const { return packet_.size() + payload_.size(); }
  /// As it was encoded.
  [[nodiscard]] stream::EncodedPacket copy() const;

 private:
  friend class Endpoint;
  wire::Body body_;
  std::size_t sequence_at_;
  zmq::message_t packet_, payload_;
};
using SharedPacket = std::shared_ptr<WirePacket>;

}  // namespace splatbus::streamer
