#include <fmt/format.h>

#include <cerrno>
#include <zmq.hpp>

#include "bus/connection_watch.h"
#include "bus/curve.h"
#include "bus/error.h"
#include "bus/private_folder.h"
#include "stream/layout.h"
#include "viewer/packet_link.h"

namespace splatbus::viewer {

namespace {

constexpr int kQueuedMessages = 64;
constexpr int kConnectMs = 3000, kHandshakeMs = 3000;

std::span<const std::uint8_t> bytes_of(const zmq::message_t& message) {
  return {static_cast<const std::uint8_t*>(message.data()), message.size()};
}

class ZmqLink final : public PacketLink {
 public:
  ZmqLink(const std::string& endpoint, const std::string& key, const std::string& server_key)
      : socket_(context_, zmq::socket_type::dealer) {
    socket_.set(zmq::sockopt::sndhwm, kQueuedMessages);
    socket_.set(zmq::sockopt::rcvhwm, kQueuedMessages);
    socket_.set(zmq::sockopt::linger, 100);
    // Not ZMQ_IMMEDIATE: a connection that ends between two frames of a message would end the process (libzmq's
    // fq.cpp).
    socket_.set(zmq::sockopt::reconnect_ivl, 50);
    socket_.set(zmq::sockopt::reconnect_ivl_max, 500);
    // In an outage tcp repeats a connection's first segment ever more seldom; a new try each second is there sooner.
    socket_.set(zmq::sockopt::connect_timeout, kConnectMs);
    socket_.set(zmq::sockopt::handshake_ivl, kHandshakeMs);
    bus::watch_connections(socket_);
    socket_.set(zmq::sockopt::maxmsgsize, static_cast<std::int64_t>(stream::kMaxPayloadBytes));
    bus::require_transport(endpoint);
    bus::require_own_endpoint(endpoint);
    if (const auto keys = bus::client_keys(endpoint, key, server_key)) bus::use_keys(socket_, *keys);
    try {
      socket_.connect(endpoint);
    } catch (const zmq::error_t& error) {
      throw bus::Error(fmt::format("{}: {}", endpoint, error.what()));
    }
  }

  void wait(std::chrono::milliseconds timeout, int wake) override {
    zmq::pollitem_t items[]{{socket_.handle(), 0, ZMQ_POLLIN, 0}, {nullptr, wake, ZMQ_POLLIN, 0}};
    try {
      zmq::poll(items, wake >= 0 ? 2 : 1, timeout);
    } catch (const zmq::error_t& error) {
      if (error.num() != EINTR) throw;
    }
  }

  std::optional<Message> receive() override {
    if (!socket_.recv(packet_, zmq::recv_flags::dontwait)) return std::nullopt;
    payload_.rebuild();
    bool more = packet_.more();
    if (more) {
      (void)socket_.recv(payload_);
      more = payload_.more();
    }
    for (zmq::message_t rest; more; more = rest.more()) (void)socket_.recv(rest);
    return Message{.packet = bytes_of(packet_), .payload = bytes_of(payload_)};
  }

  void send(std::span<const std::uint8_t> packet) override {
    // A few wait while nobody is connected, and the rest are dropped: all of these are repeated.
    (void)socket_.send(zmq::buffer(packet.data(), packet.size()), zmq::send_flags::dontwait);
  }

 private:
  zmq::context_t context_;
  zmq::socket_t socket_;
  zmq::message_t packet_, payload_;
};

}  // namespace

std::unique_ptr<PacketLink> make_zmq_link(const std::string& endpoint, const std::string& key,
                                          const std::string& server_key) {
  return std::make_unique<ZmqLink>(endpoint, key, server_key);
}

}  // namespace splatbus::viewer
