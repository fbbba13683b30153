#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <zmq.hpp>

#include "gateway/packet_gate.h"

namespace splatbus::gateway {

/// A packet on its way from the streamer to a browser.
struct StreamPacket {
  zmq::message_t packet, payload;
  [[nodiscard]] std::size_t bytes() const { return packet.size() + payload.size(); }
};

/// One browser's connection to the streamer, which takes it for a viewer. Connects again by itself when the streamer
/// comes back. One thread; `context` outlives it.
class StreamLink {
 public:
  /// An empty endpoint: to nobody. One that asks for keys gets this process's own, by SPLATBUS_KEY and
  /// SPLATBUS_SERVER_KEY. Throws bus::Error naming the endpoint.
  /// `client`: who it is that speaks, for bounds of one address; 0: this process itself.
  StreamLink(zmq::context_t& context, const std::string& endpoint, std::uint64_t client = 0);

  /// The next packet, without waiting. False when there is none; then descriptor() becomes readable before there is
  /// one. Messages that are not one or two frames are skipped.
  [[nodiscard]] bool receive(StreamPacket& packet);

  /// With what its sender may do. While there is no streamer, and while it does not read, a few wait and others are
  /// dropped: every packet of a viewer is repeated. True when descriptor() may have been emptied although there is
  /// something to receive.
  bool send(const FramedPacket& packet, const bus::Rights& rights);

  /// Its viewer is at another streamer from now on: so that this one, if it is there, does not count it any more.
  void say_goodbye();

  /// ZMQ_FD: edge-triggered.
  [[nodiscard]] int descriptor() const;

 private:
  zmq::socket_t socket_;
  std::string client_;  ///< the frame that names it; empty: none
};

}  // namespace splatbus::gateway
