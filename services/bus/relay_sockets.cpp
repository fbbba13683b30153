#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>

#include "bus/bind.h"
#include "bus/error.h"
#include "bus/private_folder.h"
#include "bus/relay.h"

// What the relay's sockets are bound to, and the bounds that their peers are kept to.
namespace splatbus::bus_service {
namespace {

constexpr int port_attempts = 50;
constexpr int remote_unread_messages = 65536;
constexpr int handshake_ms = 5000;
constexpr int backlog = 1024;  // a crowd at the door keeps nobody waiting
constexpr std::size_t max_first_bytes = std::size_t{32} << 20;
constexpr std::size_t max_all_first_bytes = std::size_t{48} << 20;
constexpr std::int64_t max_subscription_bytes = 1024;
constexpr double subscription_bytes_per_s = 16384, subscription_burst_bytes = 262144;
constexpr std::size_t max_all_subscription_bytes = std::size_t{32} << 20,
                      max_left_subscription_bytes = std::size_t{8} << 20;
constexpr double reader_stalled_s = 3, reader_min_bytes_per_s = 65536;
// While others wait for room: what a reader with 16 Mbit/s takes, and when even a model of 148 MB has been with one on
// 100 Mbit/s.
constexpr double held_min_bytes_per_s = 2e6, held_most_s = 15;

std::uint16_t port_of(const zmq::socket_t& socket) {
  const auto endpoint = socket.get(zmq::sockopt::last_endpoint);
  return static_cast<std::uint16_t>(std::stoul(endpoint.substr(endpoint.rfind(':') + 1)));
}

}  // namespace

void Relay::set_up_sockets(const BrokerOptions& options) {
  const uid_t user = ::geteuid();
  for (Side* side : {&local_, &remote_}) {
    bus::configure_socket(side->xsub, side->local);
    bus::configure_socket(side->xpub, side->local);
    // Of each reader each subscription, and the end of it.
    side->xpub.set(zmq::sockopt::xpub_verboser, true);
    for (zmq::socket_t* socket : {&side->xsub, &side->xpub}) {
      socket->set(zmq::sockopt::handshake_ivl, handshake_ms);
      socket->set(zmq::sockopt::backlog, backlog);
      if (side->local) zmq_setsockopt(socket->handle(), bus::kIpcFilterUid, &user, sizeof(user));
    }
  }
  try {
    const bus::PrivateUmask umask;
    local_.xpub.bind(options.address.subscribe_endpoint());
    local_.xsub.bind(options.address.publish_endpoint());
  } catch (const zmq::error_t& error) {
    throw bus::Error(fmt::format("{}: cannot bind: {}", options.address.text(), error.what()));
  }
}

void Relay::guard_tcp(const BrokerOptions& options) {
  if (const auto keys =
          bus::server_keys(fmt::format("tcp://{}:{}", *options.tcp_host, options.tcp_port), options.keys)) {
    allowed_ = keys->allowed;
    authenticator_.emplace(zmq_, allowed_);
    bus::require_keys(remote_.xsub, *keys, {.control = true});
    bus::require_keys(remote_.xpub, *keys, {.view = true});
  }
  const auto bytes = static_cast<std::int64_t>(options.max_remote_bytes);
  // No connection is left unread, or a PING behind what waits and a reset would end the process (decision 0146): what
  // waits is bounded by the guards. Of writers, who may publish, it is a number: small messages take more than their
  // bytes.
  remote_.xpub.set(zmq::sockopt::rcvhwm, 0);
  remote_.xsub.set(zmq::sockopt::rcvhwm, remote_unread_messages);
  remote_.xsub.set(zmq::sockopt::maxmsgsize, bytes);
  remote_.xpub.set(zmq::sockopt::maxmsgsize, max_subscription_bytes);
  writers_guard_.emplace(
      zmq_, remote_.xsub,
      bus::ConnectionLimits{.unread_bytes = options.max_remote_bytes,
                            .first_unread_bytes = std::min(max_first_bytes, options.max_remote_bytes),
                            .all_unread_bytes = options.max_remote_bytes,
                            .all_left_bytes = options.max_remote_bytes,
                            .all_first_unread_bytes = max_all_first_bytes},
      "writers over tcp");
  readers_guard_.emplace(zmq_, remote_.xpub,
                         bus::ConnectionLimits{.unread_bytes = static_cast<std::size_t>(subscription_burst_bytes),
                                               .all_unread_bytes = max_all_subscription_bytes,
                                               .all_left_bytes = max_left_subscription_bytes,
                                               .bytes_per_s = subscription_bytes_per_s,
                                               .burst_bytes = subscription_burst_bytes,
                                               .stalled_s = reader_stalled_s,
                                               .min_sent_per_s = reader_min_bytes_per_s,
                                               .held_s = reader_stalled_s,
                                               .held_min_per_s = held_min_bytes_per_s,
                                               .held_most_s = held_most_s},
                         "readers over tcp");
  if (allowed_ == nullptr) return;
  writers_guard_->keep_only([allowed = allowed_](const bus::Key& key) { return allowed->rights_of(key).control; });
  readers_guard_->keep_only([allowed = allowed_](const bus::Key& key) { return allowed->rights_of(key).view; });
}

void Relay::bind_tcp(const BrokerOptions& options) {
  const auto port = options.tcp_port == 0 ? std::string("*") : std::to_string(options.tcp_port);
  const auto bind_both = [&] {
    if (zmq_bind(remote_.xsub.handle(), fmt::format("tcp://{}:{}", *options.tcp_host, port).c_str()) != 0) {
      return zmq_errno();
    }
    const auto endpoint = remote_.xsub.get(zmq::sockopt::last_endpoint);
    tcp_port_ = port_of(remote_.xsub);
    const auto next = fmt::format("tcp://{}:{}", *options.tcp_host, tcp_port_ + 1);
    if (tcp_port_ < 65535 && zmq_bind(remote_.xpub.handle(), next.c_str()) == 0) return 0;
    const int error = tcp_port_ < 65535 ? zmq_errno() : EADDRNOTAVAIL;
    remote_.xsub.unbind(endpoint);
    return error;
  };
  for (int attempt = 1; options.tcp_port == 0 && attempt < port_attempts; ++attempt) {
    if (bind_both() == 0) return;
  }
  bus::bind_patiently(
      fmt::format("tcp://{}:{} and the port after it: cannot bind", *options.tcp_host, options.tcp_port), bind_both);
}

}  // namespace splatbus::bus_service
