#include "viewer/stream_client.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <span>
#include <utility>

#include "bus/clock.h"
#include "bus/error.h"
#include "stream/bytes.h"
#include "stream/layout.h"
#include "wire/convert.h"

namespace splatbus::viewer {

namespace {

constexpr int kQueuedMessages = 64;
constexpr int kMessagesACall = 256;
constexpr std::int64_t kHeldEveryNs = 250'000'000, kUrgentNs = 50'000'000;
constexpr std::size_t kMaxHelloPages = 6000;  // of a message that may have 64 KiB
constexpr std::size_t kMaxHeldItems = 1000;
constexpr std::size_t kMaxPictureBytes = std::size_t{1} << 27;

std::span<const std::uint8_t> bytes_of(const zmq::message_t& message) {
  return {static_cast<const std::uint8_t*>(message.data()), message.size()};
}

}  // namespace

StreamClient::StreamClient(ClientOptions options)
    : options_(std::move(options)),
      socket_(context_, zmq::socket_type::dealer),
      writer_(options_.name, static_cast<std::uint64_t>(options_.now_ns())),
      replica_(options_.max_gaussians) {
  socket_.set(zmq::sockopt::sndhwm, kQueuedMessages);
  socket_.set(zmq::sockopt::rcvhwm, kQueuedMessages);
  socket_.set(zmq::sockopt::linger, 100);
  socket_.set(zmq::sockopt::immediate, true);  // poses do not pile up for a streamer that is away
  socket_.set(zmq::sockopt::reconnect_ivl, 50);
  socket_.set(zmq::sockopt::reconnect_ivl_max, 500);
  socket_.set(zmq::sockopt::heartbeat_ivl, 1000);
  socket_.set(zmq::sockopt::heartbeat_timeout, 5000);
  socket_.set(zmq::sockopt::maxmsgsize, static_cast<std::int64_t>(stream::kMaxPayloadBytes));
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
      return replica_.receive(packet);
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
  const std::uint64_t version = replica_.scene_version();
  const bool changed = replica_.receive(packet);
  if (const std::int64_t captured_ns = replica_.scene_instant().capture_ns;
      version != 0 && replica_.scene_version() != version && captured_ns != 0) {
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
  std::vector<wire::PageVersion> held;
  for (const auto& [page, version] : replica_.held_pages()) {
    if (held.size() < kMaxHelloPages) held.emplace_back(page, version);
  }
  send(wire::Body::Hello, [&](auto& builder) {
    const wire::Camera camera = camera_ ? to_wire(*camera_) : wire::Camera();
    return wire::CreateHelloDirect(builder, options_.name.c_str(), camera_ ? &camera : nullptr, options_.probes,
                                   static_cast<std::uint32_t>(options_.max_gaussians), &held,
                                   replica_.visibility_version(), replica_.scene_version());
  });
}

void StreamClient::maintain(std::int64_t now_ns) {
  if (welcomed_ && now_ns - heard_ns_ > options_.silence_ns) welcomed_ = false;
  if (!welcomed_) {
    if (now_ns - hello_ns_ > options_.hello_every_ns) hello(now_ns);
    return;
  }
  const std::int64_t every_ns = replica_.report().urgent() ? kUrgentNs : kHeldEveryNs;
  if (now_ns - said_ns_ >= every_ns && received_bytes_ != said_bytes_) say_held(now_ns);
}

void StreamClient::say_held(std::int64_t now_ns) {
  const stream::Replica::Report& report = replica_.report();
  std::vector<wire::SequenceRange> missing;
  std::vector<wire::PageVersion> lacks;
  for (const auto& [first, last] : report.missing) {
    lost_ += last - first + 1;
    if (missing.size() < kMaxHeldItems) missing.emplace_back(first, last);
  }
  for (const auto& [page, version] : report.lacks) {
    if (lacks.size() < kMaxHeldItems) lacks.emplace_back(page, version);
  }
  std::vector<std::uint32_t> dropped = report.dropped;
  if (dropped.size() > kMaxHeldItems) dropped.resize(kMaxHeldItems);
  lacked_ += lacks.size();
  send(wire::Body::Held, [&](auto& builder) {
    return wire::CreateHeldDirect(builder, report.newest, &missing, received_bytes_ - said_bytes_,
                                  static_cast<std::uint32_t>((now_ns - said_ns_) / 1000), &lacks, &dropped,
                                  report.scene_lost, static_cast<std::uint32_t>(replica_.count()));
  });
  replica_.clear_report();
  said_ns_ = now_ns;
  said_bytes_ = received_bytes_;
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
