#include "viewer/stream_client.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <utility>

#include "bus/error.h"
#include "viewer/web_address.h"
#include "wire/convert.h"

namespace splatbus::viewer {

namespace {

constexpr int kMessagesACall = 256;
constexpr std::int64_t kFindEveryNs = 200'000'000;

std::unique_ptr<PacketLink> make_link(const ClientOptions& options) {
  if (is_web_address(options.endpoint)) {
    return make_web_link({.url = options.endpoint, .token = options.token, .ca = options.ca});
  }
  return make_zmq_link(options.endpoint, options.key, options.server_key);
}

}  // namespace

StreamClient::StreamClient(ClientOptions options)
    : options_(std::move(options)), link_(make_link(options_)), follower_(make_follower()) {
  if (!options_.packet_log.empty()) packet_log_.emplace(options_.packet_log);
}

stream::Follower StreamClient::make_follower() const {
  return stream::Follower({.name = options_.name,
                           .probes = options_.probes,
                           .hello_every_ns = options_.hello_every_ns,
                           .silence_ns = options_.silence_ns,
                           .pose_every_ns = options_.pose_every_ns,
                           .max_gaussians = options_.max_gaussians,
                           .max_kbps = options_.max_kbps,
                           .held_picture_bytes = options_.held_picture_bytes},
                          options_.now_ns());
}

StreamClient::~StreamClient() {
  send(follower_.farewell());
}

void StreamClient::send(const stream::EncodedPacket& packet) {
  link_->send(packet.packet);
}

void StreamClient::send_all() {
  while (const auto packet = follower_.next_outgoing(options_.now_ns())) send(*packet);
}

// Moves while the picture stands: the follower goes on showing what it holds until it has the other streamer's.
void StreamClient::follow_streamer() {
  const std::int64_t now_ns = options_.now_ns();
  if (!options_.find_endpoint || now_ns < next_find_ns_) return;
  next_find_ns_ = now_ns + kFindEveryNs;
  std::string found = options_.find_endpoint();
  if (found.empty() || found == options_.endpoint) return;
  ClientOptions options = options_;
  options.endpoint = std::move(found);
  std::unique_ptr<PacketLink> link;
  try {
    link = make_link(options);
  } catch (const bus::Error& error) {  // a key that has gone since: no reason to end
    if (log_limiter_.allow()) spdlog::error("the streamer stays the one that it is: {}", error.what());
    return;
  }
  send(follower_.farewell());
  options_ = std::move(options);
  link_ = std::move(link);
  follower_.restart();
}

bool StreamClient::set_budget(std::size_t max_gaussians, std::uint32_t max_kbps) {
  options_.max_kbps = max_kbps;
  follower_.set_max_kbps(max_kbps);
  if (max_gaussians == options_.max_gaussians) return false;
  std::unique_ptr<PacketLink> link;
  try {
    link = make_link(options_);
  } catch (const bus::Error& error) {  // a key that has gone since: no reason to end
    spdlog::error("the model keeps its size: {}", error.what());
    return false;
  }
  options_.max_gaussians = max_gaussians;
  send(follower_.farewell());
  link_ = std::move(link);
  before_ = {received_bytes(), refused(), lost(), lacked()};
  follower_ = make_follower();
  return true;
}

bool StreamClient::poll(std::chrono::milliseconds timeout, int wake) {
  follow_streamer();
  if (options_.find_endpoint) timeout = std::min(timeout, std::chrono::milliseconds(kFindEveryNs / 1'000'000));
  send_all();
  link_->wait(timeout, wake);
  if (link_->take_opened()) {
    follower_.restart();
    send_all();
  }
  const bool changed = receive_all();
  send_all();
  return changed;
}

bool StreamClient::receive_all() {
  bool changed = false;
  for (int i = 0; i < kMessagesACall; ++i) {
    const auto message = link_->receive();
    if (!message) break;
    changed = receive(message->packet, message->payload) || changed;
  }
  if (const auto notice = link_->take_notice()) spdlog::warn("{}", *notice);
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
