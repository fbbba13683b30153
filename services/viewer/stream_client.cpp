#include "viewer/stream_client.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <utility>

#include "bus/curve.h"
#include "bus/error.h"
#include "stream/layout.h"
#include "wire/convert.h"

namespace splatbus::viewer {

namespace {

constexpr int kQueuedMessages = 64;
constexpr int kMessagesACall = 256;

std::span<const std::uint8_t> bytes_of(const zmq::message_t& message) {
  return {static_cast<const std::uint8_t*>(message.data()), message.size()};
}

}  // namespace

StreamClient::StreamClient(ClientOptions options)
    : options_(std::move(options)),
      socket_(context_, zmq::socket_type::dealer),
      follower_({.name = options_.name,
                 .probes = options_.probes,
                 .hello_every_ns = options_.hello_every_ns,
                 .silence_ns = options_.silence_ns,
                 .pose_every_ns = options_.pose_every_ns,
                 .max_gaussians = options_.max_gaussians,
                 .held_picture_bytes = options_.held_picture_bytes},
                options_.now_ns()) {
  if (!options_.packet_log.empty()) packet_log_.emplace(options_.packet_log);
  socket_.set(zmq::sockopt::sndhwm, kQueuedMessages);
  socket_.set(zmq::sockopt::rcvhwm, kQueuedMessages);
  socket_.set(zmq::sockopt::linger, 100);
  socket_.set(zmq::sockopt::immediate, true);  // poses do not pile up for a streamer that is away
  socket_.set(zmq::sockopt::reconnect_ivl, 50);
  socket_.set(zmq::sockopt::reconnect_ivl_max, 500);
  socket_.set(zmq::sockopt::heartbeat_ivl, 1000);
  socket_.set(zmq::sockopt::heartbeat_timeout, 5000);
  socket_.set(zmq::sockopt::maxmsgsize, static_cast<std::int64_t>(stream::kMaxPayloadBytes));
  bus::require_transport(options_.endpoint);
  if (const auto keys = bus::client_keys(options_.endpoint, options_.key, options_.server_key)) {
    bus::use_keys(socket_, *keys);
  }
  try {
    socket_.connect(options_.endpoint);
  } catch (const zmq::error_t& error) {
    throw bus::Error(fmt::format("{}: {}", options_.endpoint, error.what()));
  }
}

StreamClient::~StreamClient() {
  send(follower_.farewell());
}

void StreamClient::send(const stream::EncodedPacket& packet) {
  // Dropped while nobody is connected: all of these are repeated or have become stale by then.
  (void)socket_.send(zmq::buffer(packet.packet), zmq::send_flags::dontwait);
}

void StreamClient::send_all() {
  while (const auto packet = follower_.next_outgoing(options_.now_ns())) send(*packet);
}

bool StreamClient::poll(std::chrono::milliseconds timeout, int wake) {
  send_all();
  zmq::pollitem_t items[]{{socket_.handle(), 0, ZMQ_POLLIN, 0}, {nullptr, wake, ZMQ_POLLIN, 0}};
  try {
    zmq::poll(items, wake >= 0 ? 2 : 1, timeout);
  } catch (const zmq::error_t& error) {
    if (error.num() != EINTR) throw;
  }
  const bool changed = receive_all();
  send_all();
  return changed;
}

bool StreamClient::receive_all() {
  bool changed = false;
  for (int i = 0; i < kMessagesACall; ++i) {
    zmq::message_t packet, payload;
    if (!socket_.recv(packet, zmq::recv_flags::dontwait)) break;
    bool more = packet.more();
    if (more) {
      (void)socket_.recv(payload);
      more = payload.more();
    }
    for (zmq::message_t rest; more; more = rest.more()) (void)socket_.recv(rest);
    changed = receive(bytes_of(packet), bytes_of(payload)) || changed;
  }
  if (const auto notice = follower_.take_notice(); notice && log_limiter_.allow()) spdlog::warn("{}", *notice);
  return changed;
}

bool StreamClient::receive(std::span<const std::uint8_t> packet, std::span<const std::uint8_t> payload) {
  if (packet_log_) packet_log_->add(packet, payload);
  try {
    if (lose_ && lose_(stream::ParsedPacket::parse(packet, payload))) return false;
    return follower_.receive(packet, payload, options_.now_ns());
  } catch (const std::runtime_error& error) {
    // The same again is no news.
    if (last_refusal_ != error.what() && log_limiter_.allow()) {
      last_refusal_ = error.what();
      spdlog::warn("{}: {}", options_.endpoint, error.what());
    }
    return false;
  }
}

void StreamClient::send_probe(std::uint64_t probe_id, const Camera& camera) {
  follower_.say(wire::Body::Probe, [&](auto& builder) {
    const wire::Camera wired = to_wire(camera);
    return wire::CreateProbe(builder, probe_id, &wired);
  });
}

void StreamClient::send_quality(std::uint64_t probe_id, const metrics::Quality& quality,
                                std::int64_t first_picture_ns) {
  follower_.say(wire::Body::Quality, [&](auto& builder) {
    return wire::CreateQuality(builder, probe_id, static_cast<float>(quality.psnr_db), static_cast<float>(quality.ssim),
                               static_cast<float>(quality.flip), replica().count(), first_picture_ns);
  });
}

}  // namespace splatbus::viewer
