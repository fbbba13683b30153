#include "streamer/endpoint.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <sys/file.h>

#include <cerrno>
#include <cstring>
#include <span>
#include <utility>

#include "bus/error.h"
#include "stream/bytes.h"
#include "stream/layout.h"

namespace splatbus::streamer {

namespace {

constexpr std::string_view kIpc = "ipc://";
constexpr std::size_t kMaxParts = 2;  // packet and payload
constexpr int kSkippedACall = 64;     // of what is no packet
constexpr int kHeartbeatMs = 1000;
constexpr int kHeartbeatTimeoutMs = 5000;

std::span<const std::uint8_t> bytes_of(const zmq::message_t& message) {
  return {static_cast<const std::uint8_t*>(message.data()), message.size()};
}

// Freed by the kernel when its holder dies, so that a killed streamer is no hindrance.
bus::FileDescriptor lock_beside(const std::string& path) {
  const std::string name = path + ".lock";
  bus::FileDescriptor file(::open(name.c_str(), O_CREAT | O_RDWR | O_CLOEXEC, 0600));
  if (!file.valid()) throw bus::Error(fmt::format("{}: {}", name, std::strerror(errno)));
  if (::flock(file.get(), LOCK_EX | LOCK_NB) != 0) {
    throw bus::Error(fmt::format("ipc://{}: another streamer is bound there", path));
  }
  return file;
}

}  // namespace

WirePacket::WirePacket(const stream::EncodedPacket& packet)
    : body_(packet.body),
      sequence_at_(stream::sequence_offset(packet.packet)),
      packet_(packet.packet.data(), packet.packet.size()),
      payload_(packet.payload.data(), packet.payload.size()) {}

stream::EncodedPacket WirePacket::copy() const {
  const auto bytes = bytes_of(packet_), payload = bytes_of(payload_);
  return {.body = body_,
          .sequence = 0,
          .packet = {bytes.begin(), bytes.end()},
          .payload = {payload.begin(), payload.end()}};
}

Endpoint::Endpoint(const std::vector<std::string>& endpoints) : socket_(context_, zmq::socket_type::router) {
  socket_.set(zmq::sockopt::router_mandatory, true);
  socket_.set(zmq::sockopt::sndhwm, kQueuedPackets);
  socket_.set(zmq::sockopt::rcvhwm, 256);
  socket_.set(zmq::sockopt::linger, 0);
  socket_.set(zmq::sockopt::maxmsgsize, static_cast<std::int64_t>(stream::kMaxPacketBytes));
  socket_.set(zmq::sockopt::heartbeat_ivl, kHeartbeatMs);
  socket_.set(zmq::sockopt::heartbeat_timeout, kHeartbeatTimeoutMs);
  for (const std::string& endpoint : endpoints) {
    try {
      if (endpoint.starts_with(kIpc)) locks_.push_back(lock_beside(endpoint.substr(kIpc.size())));
      socket_.bind(endpoint);
    } catch (const zmq::error_t& error) {
      throw bus::Error(fmt::format("{}: {}", endpoint, error.what()));
    }
    bound_.push_back(socket_.get(zmq::sockopt::last_endpoint));
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
  for (int skipped = 0; skipped < kSkippedACall && socket_.recv(frame, zmq::recv_flags::dontwait); ++skipped) {
    const Peer peer = frame.to_string();
    std::vector<zmq::message_t> parts;
    // To its very last part: what is left behind would be read as the next sender's routing id.
    for (bool more = frame.more(); more; more = socket_.get(zmq::sockopt::rcvmore) != 0) {
      zmq::message_t part;
      (void)socket_.recv(part);
      if (parts.size() <= kMaxParts) parts.push_back(std::move(part));
    }
    try {
      if (parts.empty() || parts.size() > kMaxParts)
        throw stream::StreamError("a message of one or two frames was expected");
      return Received{
          peer, stream::ParsedPacket::parse(bytes_of(parts[0]),
                                            parts.size() > 1 ? bytes_of(parts[1]) : std::span<const std::uint8_t>())};
    } catch (const stream::StreamError& error) {
      ++malformed_;
      if (log_limiter_.allow()) spdlog::warn("a viewer sent what is no packet: {}", error.what());
    }
  }
  return std::nullopt;
}

}  // namespace splatbus::streamer
