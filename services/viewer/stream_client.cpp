#include "viewer/stream_client.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <span>
#include <utility>

#include "bus/clock.h"
#include "bus/curve.h"
#include "bus/error.h"
#include "stream/bytes.h"
#include "stream/layout.h"
#include "wire/convert.h"

namespace splatbus::viewer {

namespace {

constexpr int kQueuedMessages = 64;
constexpr int kMessagesACall = 256;
constexpr std::int64_t kAskAgainNs = 250'000'000;
constexpr std::int64_t kMinSnapshotWaitNs = 2'000'000'000, kMaxSnapshotWaitNs = 64'000'000'000;
constexpr std::int64_t kSnapshotStalledNs = 3'000'000'000;
constexpr std::size_t kMaxPictureBytes = std::size_t{1} << 27;

std::span<const std::uint8_t> bytes_of(const zmq::message_t& message) {
  return {static_cast<const std::uint8_t*>(message.data()), message.size()};
}

}  // namespace

StreamClient::StreamClient(ClientOptions options)
    : options_(std::move(options)),
      socket_(context_, zmq::socket_type::dealer),
      writer_(options_.name, static_cast<std::uint64_t>(options_.now_ns())) {
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
  send(wire::Body::Bye, [](auto& builder) { return wire::CreateByeDirect(builder, "the viewer ends"); });
}

template <class Build>
void StreamClient::send(wire::Body body, Build&& build) {
  const stream::EncodedPacket packet = writer_.write(replica_.epoch(), 0, body, build);
  // Dropped while nobody is connected: all of these are repeated or have become stale by then.
  (void)socket_.send(zmq::buffer(packet.packet), zmq::send_flags::dontwait);
}

bool StreamClient::poll(std::chrono::milliseconds timeout, int wake) {
  maintain(options_.now_ns());
  zmq::pollitem_t items[]{{socket_.handle(), 0, ZMQ_POLLIN, 0}, {nullptr, wake, ZMQ_POLLIN, 0}};
  try {
    zmq::poll(items, wake >= 0 ? 2 : 1, timeout);
  } catch (const zmq::error_t& error) {
    if (error.num() != EINTR) throw;
  }
  const bool changed = receive_all();
  maintain(options_.now_ns());
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
    received_bytes_ += packet.size() + payload.size();
    heard_ns_ = options_.now_ns();
    try {
      changed = take(stream::ParsedPacket::parse(bytes_of(packet), bytes_of(payload))) || changed;
    } catch (const std::runtime_error& error) {
      ++refused_;
      // The same again is no news.
      if (last_refusal_ != error.what() && log_limiter_.allow()) {
        last_refusal_ = error.what();
        spdlog::warn("{}: {}", options_.endpoint, error.what());
      }
    }
  }
  return changed;
}

bool StreamClient::take(const stream::ParsedPacket& packet) {
  if (lose_ && lose_(packet)) return false;
  switch (packet.body()) {
    case wire::Body::Welcome:
      // One that asks is followed by a Hello when maintain() next runs, at once but not once for each that comes.
      welcomed_ = !packet.root().body_as_Welcome()->asks();
      return false;
    case wire::Body::ProbePicture:
      take_probe_picture(packet);
      return false;
    case wire::Body::Bye: {
      const auto* reason = packet.root().body_as_Bye()->reason();
      if (log_limiter_.allow()) spdlog::warn("the streamer says: {}", reason ? reason->string_view() : "");
      return false;
    }
    default:
      break;
  }
  switch (packet.body()) {
    case wire::Body::Snapshot:
    case wire::Body::SnapshotBegin:
    case wire::Body::GaussianOrder:
      progress_ns_ = options_.now_ns();
      break;
    default:
      break;
  }
  const std::uint64_t version = replica_.scene_version();
  const bool changed = replica_.receive(packet);
  if (const std::int64_t captured_ns = replica_.scene_instant().capture_ns;
      packet.sequence() != 0 && replica_.scene_version() != version && captured_ns != 0) {
    scene_delays_.add(static_cast<double>(options_.now_ns() - captured_ns) / 1e6);
  }
  return changed;
}

void StreamClient::take_probe_picture(const stream::ParsedPacket& packet) {
  if (!options_.probes) return;
  const wire::ProbePicture& body = *packet.root().body_as_ProbePicture();
  ProbeAnswer answer{.probe_id = body.probe_id(),
                     .camera = from_wire(*body.camera()),
                     .scene = {.light = from_wire(*body.light()), .objects = from_wire(body.objects())},
                     .rgba = {}};
  const std::size_t bytes = std::size_t{answer.camera.width} * answer.camera.height * 4;
  if (bytes > kMaxPictureBytes || body.raw_bytes() != bytes) {
    throw stream::StreamError(fmt::format("ProbePicture: {} bytes for {} x {} pixels", body.raw_bytes(),
                                          answer.camera.width, answer.camera.height));
  }
  if (answer_bytes_ + bytes > options_.held_picture_bytes) {
    if (log_limiter_.allow()) spdlog::warn("probe pictures come faster than they are compared: one is left out");
    return;
  }
  answer.rgba = stream::zstd_decompress(packet.payload(), bytes, "ProbePicture");
  answer_bytes_ += bytes;
  answers_.push_back(std::move(answer));
}

std::optional<ProbeAnswer> StreamClient::take_probe_answer() {
  if (answers_.empty()) return std::nullopt;
  ProbeAnswer answer = std::move(answers_.front());
  answers_.pop_front();
  answer_bytes_ -= answer.rgba.size();
  return answer;
}

void StreamClient::hello(std::int64_t now_ns) {
  hello_ns_ = now_ns;
  const stream::ReplicatedState* held = replica_.held();
  const bool follows = held && !replica_.loading() && !replica_.needs_snapshot();
  send(wire::Body::Hello, [&](auto& builder) {
    const wire::Camera camera = camera_ ? to_wire(*camera_) : wire::Camera();
    return wire::CreateHelloDirect(builder, options_.name.c_str(), camera_ ? &camera : nullptr, options_.probes,
                                   follows ? held->sequence : 0);
  });
}

void StreamClient::maintain(std::int64_t now_ns) {
  if (welcomed_ && now_ns - heard_ns_ > options_.silence_ns) welcomed_ = false;
  if (!welcomed_) {
    if (now_ns - hello_ns_ > options_.hello_every_ns) hello(now_ns);
    return;
  }
  if (const bool stalled = replica_.loading() && now_ns - progress_ns_ > kSnapshotStalledNs;
      stalled || replica_.needs_snapshot()) {
    ask_for_snapshot(now_ns, stalled ? "chunks are missing" : replica_.refusal());
    return;
  }
  if (!replica_.loading()) next_snapshot_ns_ = snapshot_wait_ns_ = 0;
  if (now_ns - asked_ns_ < kAskAgainNs) return;
  if (const auto missing = replica_.missing()) {
    asked_ns_ = now_ns;
    ++resends_;
    send(wire::Body::Resend, [&](auto& builder) { return wire::CreateResend(builder, missing->first, missing->last); });
  }
}

// Snapshots are dear, and one that was refused will mostly be refused again: ever more seldom, until one is held.
void StreamClient::ask_for_snapshot(std::int64_t now_ns, const std::string& reason) {
  if (now_ns < next_snapshot_ns_) return;
  snapshot_wait_ns_ = std::clamp(2 * snapshot_wait_ns_, kMinSnapshotWaitNs, kMaxSnapshotWaitNs);
  next_snapshot_ns_ = now_ns + snapshot_wait_ns_;
  progress_ns_ = now_ns;
  ++snapshot_requests_;
  send(wire::Body::NeedSnapshot,
       [&](auto& builder) { return wire::CreateNeedSnapshotDirect(builder, reason.c_str()); });
}

void StreamClient::send_pose(const Camera& camera) {
  camera_ = camera;
  send(wire::Body::Pose, [&](auto& builder) {
    const wire::Camera wired = to_wire(camera);
    return wire::CreatePose(builder, &wired);
  });
}

void StreamClient::send_probe(std::uint64_t probe_id, const Camera& camera) {
  send(wire::Body::Probe, [&](auto& builder) {
    const wire::Camera wired = to_wire(camera);
    return wire::CreateProbe(builder, probe_id, &wired);
  });
}

void StreamClient::send_quality(std::uint64_t probe_id, const metrics::Quality& quality,
                                std::int64_t first_picture_ns) {
  send(wire::Body::Quality, [&](auto& builder) {
    return wire::CreateQuality(builder, probe_id, static_cast<float>(quality.psnr_db), static_cast<float>(quality.ssim),
                               static_cast<float>(quality.flip), replica_.count(), first_picture_ns);
  });
}

}  // namespace splatbus::viewer
