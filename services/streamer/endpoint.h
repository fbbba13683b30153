#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>
#include <zmq.hpp>

#include "bus/connection_guard.h"
#include "bus/curve.h"
#include "bus/file_descriptor.h"
#include "bus/log_sink.h"
#include "bus/rights.h"
#include "streamer/wire_packet.h"

namespace splatbus::streamer {

struct EndpointOptions {
  bus::ServerKeyFiles keys;  ///< for tcp endpoints that others than this machine reach
  double silence_s = 15;     ///< a tcp connection that says nothing for so long is closed
};

/// Where viewers connect: over ipc, and over tcp, without a key on the loopback address only. One thread.
class Endpoint {
 public:
  /// A viewer's connection: ZeroMQ's routing id. Another one after a viewer has reconnected.
  using Peer = std::string;
  enum class Sent : std::uint8_t { Yes, Full, Gone };
  static constexpr int kQueuedPackets = 64;  ///< for a viewer that does not read; then send() says Full

  static constexpr std::int64_t kMaxFrameBytes = 65536;  ///< from a viewer

  /// Binds `endpoints`. An ipc path is held by a lock file beside it, since a second bind would silently steal it, and
  /// takes this user's processes only. Throws bus::Error naming the endpoint and what is wrong: it is neither ipc nor
  /// tcp, is taken, needs a key, or lies where another user might have put it.
  explicit Endpoint(const std::vector<std::string>& endpoints, const EndpointOptions& options = {});

  /// `sequence`: this peer's number of the packet; 0: as it was written.
  [[nodiscard]] Sent send(const Peer& peer, const WirePacket& packet, std::uint64_t sequence = 0);

  struct Received {
    Peer peer;
    stream::ParsedPacket packet;
    bus::Rights rights = bus::Rights::all();  ///< of this connection
    /// What bounds for one address hold for: the sender's, or the one that a service names as its client's; empty: a
    /// process of this user's own, or one over plain tcp on the loopback address.
    std::string address{};
    bool is_service = true;  ///< one of those, or one whose key may control
  };
  /// The next packet, without waiting; null too after many messages that were none. What is no Packet is counted,
  /// logged at most once a second, and skipped; so is what somebody sends whose key may not view (any more), and that
  /// connection is closed.
  std::optional<Received> receive();

  /// Throws bus::Error once an ipc path has been removed: viewers who come do not find this streamer any more.
  void require_intact() const;

  [[nodiscard]] void* socket() { return socket_.handle(); }
  [[nodiscard]] std::uint64_t malformed() const { return malformed_; }
  /// tcp connections.
  [[nodiscard]] bus::ConnectionGuard::Counts connections() const { return guard_->counts(); }
  /// As bound; a tcp endpoint with its real port.
  [[nodiscard]] const std::vector<std::string>& bound() const { return bound_; }

 private:
  std::string bind(const std::string& endpoint);
  std::optional<Received> parse(const Peer& peer, const std::vector<zmq::message_t>& parts);

  zmq::context_t context_;
  std::shared_ptr<bus::AllowList> allowed_;
  std::optional<bus::Authenticator> authenticator_;
  zmq::socket_t socket_;
  std::optional<bus::ConnectionGuard> guard_;
  std::vector<std::string> bound_;
  std::vector<std::pair<std::string, bus::FileDescriptor>> locks_;  ///< path of an ipc endpoint
  std::uint64_t malformed_ = 0;
  bus::LogLimiter log_limiter_;
};

}  // namespace splatbus::streamer
