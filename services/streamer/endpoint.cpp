#include "streamer/endpoint.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <span>
#include <utility>

#include "bus/bind.h"
#include "bus/connection_watch.h"
#include "bus/error.h"
#include "bus/private_folder.h"
#include "bus/schemes.h"
#include "stream/bytes.h"
#include "stream/relay_client.h"
#include "streamer/peer_address.h"

namespace splatbus::streamer {

namespace {

constexpr int kMessagesACall = 256;   // that are none, before others get their turn
constexpr std::size_t kMaxParts = 4;  // a relay's frames of rights and client, packet, payload
constexpr int kQueuedFromViewer = 256;
constexpr int kHandshakeMs = 5000;
constexpr int kBacklog = 1024;
// Of one tcp connection. A pose has about 200 bytes, and the largest that a viewer says kMaxFrameBytes.
constexpr std::size_t kUnreadBytes = std::size_t{1} << 20;
constexpr std::size_t kFirstUnreadBytes = 2 * Endpoint::kMaxFrameBytes;  // of a Hello, and what is said behind it
constexpr double kBytesPerSecond = 1 << 20;
constexpr double kGreetingSeconds = 5;
constexpr double kMinSentPerSecond = 1000;

std::span<const std::uint8_t> bytes_of(const zmq::message_t& message) {
  return {static_cast<const std::uint8_t*>(message.data()), message.size()};
}

// Freed by the kernel when its holder dies, so that a killed streamer is no hindrance.
bus::FileDescriptor lock_beside(const std::string& path) {
  const std::string name = path + ".lock";
  bus::FileDescriptor file(::open(name.c_str(), O_CREAT | O_RDWR | O_CLOEXEC | O_NOFOLLOW, 0600));
  if (!file.valid())
    throw bus::Error(fmt::format("cannot lock the endpoint ipc://{}: {}: {}", path, name, std::strerror(errno)));
  if (::flock(file.get(), LOCK_EX | LOCK_NB) != 0) {
    throw bus::Error(fmt::format("ipc://{}: another streamer is bound there", path));
  }
  return file;
}

}  // namespace

Endpoint::Endpoint(const std::vector<std::string>& endpoints, const EndpointOptions& options)
    : socket_(context_, zmq::socket_type::router), bound_(endpoints.size()) {
  socket_.set(zmq::sockopt::router_mandatory, true);
  socket_.set(zmq::sockopt::sndhwm, kQueuedPackets);
  socket_.set(zmq::sockopt::linger, 0);
  socket_.set(zmq::sockopt::maxmsgsize, kMaxFrameBytes);
  socket_.set(zmq::sockopt::handshake_ivl, kHandshakeMs);
  socket_.set(zmq::sockopt::backlog, kBacklog);  // a crowd at the door keeps nobody waiting
  bus::watch_connections(socket_);
  guard_.emplace(context_, socket_,
                 bus::ConnectionLimits{.unread_bytes = kUnreadBytes,
                                       .first_unread_bytes = kFirstUnreadBytes,
                                       .all_unread_bytes = 8 * kUnreadBytes,
                                       .all_left_bytes = 2 * kUnreadBytes,
                                       .bytes_per_s = kBytesPerSecond,
                                       .burst_bytes = 4 * kBytesPerSecond,
                                       .greeting_s = kGreetingSeconds,
                                       .silence_s = options.silence_s,
                                       .stalled_s = options.silence_s,
                                       .min_sent_per_s = kMinSentPerSecond},
                 "viewers");
  // Those without keys first: a socket's options are those of what it binds from then on.
  for (const bool with_keys : {false, true}) {
    for (std::size_t i = 0; i < endpoints.size(); ++i) {
      bus::require_transport(endpoints[i]);
      const auto keys = bus::server_keys(endpoints[i], options.keys);
      if (keys.has_value() != with_keys) continue;
      if (keys && !authenticator_) {
        allowed_ = keys->allowed;
        authenticator_.emplace(context_, allowed_);
        bus::require_keys(socket_, *keys, {.view = true});
        guard_->keep_only([allowed = allowed_](const bus::Key& key) { return allowed->rights_of(key).view; });
      }
      bound_[i] = bind(endpoints[i]);
    }
  }
}

std::string Endpoint::bind(const std::string& endpoint) {
  // A connection over tcp is never left unread, or a PING behind what waits and a reset would end the process (decision
  // 0146): what waits is bounded by the guard.
  const bool is_ipc = endpoint.starts_with(bus::ipc_scheme);
  socket_.set(zmq::sockopt::rcvhwm, is_ipc ? kQueuedFromViewer : 0);
  if (is_ipc) {
    const std::string path = endpoint.substr(bus::ipc_scheme.size());
    bus::require_own_endpoint(endpoint, bus::EndpointUse::Bind);
    const ::uid_t user = ::geteuid();
    zmq_setsockopt(socket_.handle(), bus::kIpcFilterUid, &user, sizeof(user));
    locks_.emplace_back(path, lock_beside(path));
  }
  bus::bind_patiently(endpoint, [&] {
    const bus::PrivateUmask umask;
    return zmq_bind(socket_.handle(), endpoint.c_str()) == 0 ? 0 : zmq_errno();
  });
  return socket_.get(zmq::sockopt::last_endpoint);
}

void Endpoint::require_intact() const {
  for (const auto& [path, lock] : locks_) {
    if (::access(path.c_str(), F_OK) != 0) throw bus::Error(fmt::format("ipc://{}: it was removed", path));
  }
}

Endpoint::Sent Endpoint::send(const Peer& peer, const WirePacket& packet, std::uint64_t sequence) {
  try {
    const zmq::const_buffer id = zmq::buffer(peer);
    const auto flags = zmq::send_flags::dontwait | zmq::send_flags::sndmore;
    if (!socket_.send(id, flags)) return Sent::Full;
    // Once the routing id is accepted, the rest of the message is.
    zmq::message_t first, second;
    if (sequence == 0) {
      first.copy(const_cast<zmq::message_t&>(packet.packet_));
    } else {
      first.rebuild(packet.packet_.data(), packet.packet_.size());
      flatbuffers::WriteScalar(static_cast<std::uint8_t*>(first.data()) + packet.sequence_at_, sequence);
    }
    const bool has_payload = !packet.payload_.empty();
    socket_.send(first, has_payload ? flags : zmq::send_flags::dontwait);
    if (has_payload) {
      second.copy(const_cast<zmq::message_t&>(packet.payload_));
      socket_.send(second, zmq::send_flags::dontwait);
    }
    return Sent::Yes;
  } catch (const zmq::error_t& error) {
    if (error.num() == EHOSTUNREACH) return Sent::Gone;
    throw;
  }
}

std::optional<Endpoint::Received> Endpoint::receive() {
  zmq::message_t frame;
  for (int i = 0; i < kMessagesACall; ++i) {
    if (!socket_.recv(frame, zmq::recv_flags::dontwait)) {
      guard_->drained();
      break;
    }
    const Peer peer = frame.to_string();
    std::vector<zmq::message_t> parts;
    std::size_t bytes = 0;
    // To its very last part: what is left behind would be read as the next sender's routing id.
    for (bool more = frame.more(); more; more = socket_.get(zmq::sockopt::rcvmore) != 0) {
      zmq::message_t part;
      (void)socket_.recv(part);
      bytes += part.size();
      if (parts.size() <= kMaxParts) parts.push_back(std::move(part));
    }
    if (!parts.empty()) guard_->took(parts[0], bytes);
    if (auto received = parse(peer, parts)) return received;
  }
  return std::nullopt;
}

std::optional<Endpoint::Received> Endpoint::parse(const Peer& peer, const std::vector<zmq::message_t>& parts) {
  try {
    std::span<const zmq::message_t> frames(parts);
    bus::Rights rights = frames.empty() ? bus::Rights() : bus::sender_rights(frames[0], allowed_.get());
    if (!frames.empty() && !rights.view) {
      guard_->close(frames[0], "its key is not allowed to view");
      return std::nullopt;
    }
    PeerAddress address = frames.empty() ? PeerAddress() : peer_address(frames[0]);
    const bool has_key = !frames.empty() && !bus::sender_key(frames[0]).empty();
    // Where the loopback address takes no keys, this machine is trusted as over ipc.
    const bool is_plain = !has_key && address.text == PeerAddress::kLoopback;
    const bool is_service = address.is_local || is_plain || (has_key && rights.control);
    if (is_plain) address.text.clear();
    if (frames.size() > 1) {
      if (const auto relayed = bus::parse_rights_frame(frames[0].to_string_view())) {
        rights = rights & *relayed;
        frames = frames.subspan(1);
      }
    }
    if (frames.size() > 1) {
      // Whoever else names clients might name as many as it likes.
      if (const auto client = stream::parse_client_frame(frames[0].to_string_view())) {
        if (is_service) address.text = stream::client_frame(*client);
        frames = frames.subspan(1);
      }
    }
    if (frames.empty() || frames.size() > 2) throw stream::StreamError("a message of one or two frames was expected");
    return Received{.peer = peer,
                    .packet = stream::ParsedPacket::parse(
                        bytes_of(frames[0]), frames.size() > 1 ? bytes_of(frames[1]) : std::span<const std::uint8_t>()),
                    .rights = rights,
                    .address = std::move(address.text),
                    .is_service = is_service};
  } catch (const std::exception& error) {
    ++malformed_;
    if (log_limiter_.allow()) spdlog::warn("a viewer sent something that is not a packet: {}", error.what());
    return std::nullopt;
  }
}

}  // namespace splatbus::streamer
