#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>
#include <zmq.hpp>

#include "bus/file_descriptor.h"
#include "bus/log_sink.h"
#include "bus/rights.h"
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

/// Where viewers connect. One thread.
class Endpoint {
 public:
  /// A viewer's connection: ZeroMQ's routing id. Another one after a viewer has reconnected.
  using Peer = std::string;
  enum class Sent : std::uint8_t { Yes, Full, Gone };
  static constexpr int kQueuedPackets = 64;  ///< for a viewer that does not read; then send() says Full

  /// Binds `endpoints`. An ipc path is held by a lock file beside it, since a second bind would silently steal it.
  /// Throws bus::Error naming the endpoint and what is wrong.
  explicit Endpoint(const std::vector<std::string>& endpoints);

  /// `sequence`: this peer's number of the packet; 0: as it was written.
  [[nodiscard]] Sent send(const Peer& peer, const WirePacket& packet, std::uint64_t sequence = 0);

  struct Received {
    Peer peer;
    stream::ParsedPacket packet;
    bus::Rights rights = bus::Rights::all();  ///< of this connection
  };
  /// The next packet, without waiting. What is no Packet is counted, logged at most once a second, and skipped, so many
  /// a call.
  std::optional<Received> receive();

  [[nodiscard]] void* socket() { return socket_.handle(); }
  [[nodiscard]] std::uint64_t malformed() const { return malformed_; }
  /// As bound; a tcp endpoint with its real port.
  [[nodiscard]] const std::vector<std::string>& bound() const { return bound_; }

 private:
  zmq::context_t context_;
  zmq::socket_t socket_;
  std::vector<std::string> bound_;
  std::vector<bus::FileDescriptor> locks_;
  std::uint64_t malformed_ = 0;
  bus::LogLimiter log_limiter_;
};

}  // namespace splatbus::streamer
