#include "bus/relay.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <sys/eventfd.h>

#include <algorithm>
#include <utility>

#include "bus/clock.h"
#include "bus/error.h"
#include "bus/frames.h"
#include "wire/topics.h"

namespace splatbus::bus_service {
namespace {

constexpr int messages_a_turn = 512;  // before the other sockets get theirs
constexpr std::int64_t beat_ns = 200'000'000;
constexpr std::int64_t report_ns = 1'000'000'000;
constexpr int port_attempts = 50;

std::string latch_key_of(const wire::Header& header) {
  return header.latch_key() == nullptr ? std::string() : header.latch_key()->str();
}

const wire::Header& header_of(const bus::Frames& frames) {
  return *flatbuffers::GetRoot<wire::Envelope>(frames.body.data())->header();
}

// Whether a latched message says what is known already, or less: publishers repeat theirs when a broker comes back, and
// a repeat may cross with something newer. Clocks and epochs compare on one machine only.
bool is_stale(const wire::Header& header, const bus::LatchStore::Held& held, bool local) {
  const auto& known = header_of(held.frames);
  if (header.source()->string_view() != known.source()->string_view()) {
    return local && header.publish_ns() < held.stamp;
  }
  if (header.epoch() == known.epoch()) return header.sequence() <= known.sequence();
  return local && header.epoch() < known.epoch();
}

std::uint16_t port_of(const zmq::socket_t& socket) {
  const auto endpoint = socket.get(zmq::sockopt::last_endpoint);
  return static_cast<std::uint16_t>(std::stoul(endpoint.substr(endpoint.rfind(':') + 1)));
}

}  // namespace

Relay::Relay(const BrokerOptions& options, FindSlab find_slab, std::function<std::size_t()> count_slabs)
    : find_slab_(std::move(find_slab)),
      count_slabs_(std::move(count_slabs)),
      local_{true, {zmq_, zmq::socket_type::xsub}, {zmq_, zmq::socket_type::xpub}},
      remote_{false, {zmq_, zmq::socket_type::xsub}, {zmq_, zmq::socket_type::xpub}},
      held_(options.max_held_messages, options.max_held_bytes),
      wake_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
  if (!wake_.valid()) throw bus::Error("cannot make an eventfd");
  for (Side* side : {&local_, &remote_}) {
    bus::configure_socket(side->xsub, side->local);
    bus::configure_socket(side->xpub, side->local);
    side->xpub.set(zmq::sockopt::xpub_verbose, true);
  }
  try {
    local_.xpub.bind(options.address.subscribe_endpoint());
    local_.xsub.bind(options.address.publish_endpoint());
  } catch (const zmq::error_t& error) {
    throw bus::Error(fmt::format("{}: cannot bind: {}", options.address.text(), error.what()));
  }
  if (options.tcp_host) bind_tcp(options);
  // Everything comes here whether or not somebody reads it: latched messages and heartbeats are kept.
  const std::uint8_t everything = 1;
  local_.xsub.send(zmq::buffer(&everything, 1));
  remote_.xsub.send(zmq::buffer(&everything, 1));
  thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

Relay::~Relay() {
  thread_.request_stop();
  ::eventfd_write(wake_.get(), 1);
  thread_.join();
}

void Relay::bind_tcp(const BrokerOptions& options) {
  const int attempts = options.tcp_port == 0 ? port_attempts : 1;
  std::string reason;
  for (int attempt = 0; attempt < attempts; ++attempt) {
    try {
      const auto port = options.tcp_port == 0 ? std::string("*") : std::to_string(options.tcp_port);
      remote_.xsub.bind(fmt::format("tcp://{}:{}", *options.tcp_host, port));
    } catch (const zmq::error_t& error) {
      reason = error.what();
      break;
    }
    const auto endpoint = remote_.xsub.get(zmq::sockopt::last_endpoint);
    tcp_port_ = port_of(remote_.xsub);
    try {
      if (tcp_port_ == 65535) throw zmq::error_t();
      remote_.xpub.bind(fmt::format("tcp://{}:{}", *options.tcp_host, tcp_port_ + 1));
      return;
    } catch (const zmq::error_t& error) {
      reason = error.what();
      remote_.xsub.unbind(endpoint);
    }
  }
  throw bus::Error(
      fmt::format("tcp://{}:{} and the port after it: cannot bind: {}", *options.tcp_host, options.tcp_port, reason));
}

BrokerStatistics Relay::statistics() const {
  BrokerStatistics result;
  result.relayed = relayed_;
  result.malformed = malformed_;
  result.inlined = inlined_;
  result.inline_dropped = inline_dropped_;
  result.held = held_count_;
  result.slabs = count_slabs_();
  return result;
}

void Relay::run(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    zmq_pollitem_t items[] = {{nullptr, wake_.get(), ZMQ_POLLIN, 0},
                              {local_.xsub.handle(), 0, ZMQ_POLLIN, 0},
                              {local_.xpub.handle(), 0, ZMQ_POLLIN, 0},
                              {remote_.xsub.handle(), 0, ZMQ_POLLIN, 0},
                              {remote_.xpub.handle(), 0, ZMQ_POLLIN, 0}};
    const std::int64_t left_ms = std::max<std::int64_t>(0, (next_beat_ns_ - bus::now_ns()) / 1'000'000 + 1);
    zmq_poll(items, std::size(items), static_cast<long>(left_ms));
    for (Side* side : {&local_, &remote_}) {
      read_subscriptions(*side);
      relay_from(*side);
    }
    tick();
  }
  relay(own_.heartbeat(statistics(), wire::ServiceState::Stopping), true);
}

void Relay::relay_from(Side& side) {
  for (int i = 0; i < messages_a_turn; ++i) {
    bus::Frames frames;
    std::string why;
    const auto result = bus::receive_frames(side.xsub, frames, why);
    if (result == bus::RecvResult::Nothing) return;
    if (result == bus::RecvResult::Malformed) {
      refuse(frames, why);
    } else {
      relay(frames, side.local);
    }
  }
}

void Relay::relay(const bus::Frames& frames, bool local) {
  std::string why;
  const auto* const header = bus::verified_header(frames.body, why);
  if (header == nullptr) return refuse(frames, why);
  if (!local && has_slab_tensors(*header)) return refuse(frames, "a tensor in a slab cannot come over tcp");
  if (frames.topic_text() == topics::kHeartbeat.name) {
    flatbuffers::Verifier verifier(frames.body.data<std::uint8_t>(), frames.body.size(), 8, 4096);
    if (!verifier.VerifyBuffer<wire::Heartbeat>(nullptr)) return refuse(frames, "it does not verify as a Heartbeat");
    liveness_.note(*flatbuffers::GetRoot<wire::Heartbeat>(frames.body.data()), bus::now_ns());
  }
  if (header->latch() && !hold(frames, *header, local)) return;
  ++relayed_;
  topics_.note(frames.topic_text(), *header, frames.body.size());
  send(local_, frames, *header);
  send(remote_, frames, *header);
}

bool Relay::hold(const bus::Frames& frames, const wire::Header& header, bool local) {
  const auto topic = frames.topic.to_string();
  const auto key = latch_key_of(header);
  const auto* known = held_.find(topic, key);
  if (known != nullptr && is_stale(header, *known, local)) {
    warn_of_namesakes(topic, header, header_of(known->frames));
    return false;
  }
  bus::Frames copy;
  copy.topic.rebuild(frames.topic.data(), frames.topic.size());
  copy.body.rebuild(frames.body.data(), frames.body.size());
  flatbuffers::GetMutableRoot<wire::Envelope>(copy.body.data())->mutable_header()->mutate_resent(true);
  if (frames.has_payload) {
    copy.payload.rebuild(frames.payload.data(), frames.payload.size());
    copy.has_payload = true;
  }
  // A publisher whose clock is ahead, by error or on purpose, shall not keep others out.
  const std::int64_t stamp = local ? std::min(header.publish_ns(), bus::now_ns()) : 0;
  const std::size_t evicted = held_.put(topic, key, next_order_++, std::move(copy), stamp);
  if (evicted > 0 && limiter_.allow()) {
    spdlog::warn("{} held messages of other topics and keys gave way to {}", evicted, bus::printable(topic));
  }
  held_count_ = held_.size();
  return true;
}

void Relay::warn_of_namesakes(const std::string& topic, const wire::Header& header, const wire::Header& known) {
  if (topic != topics::kHeartbeat.name || header.epoch() >= known.epoch() || !limiter_.allow()) return;
  spdlog::warn("two processes call themselves '{}'; the one that started first is not heard",
               bus::printable(header.source()->string_view()));
}

void Relay::send(Side& side, const bus::Frames& frames, const wire::Header& header) {
  if (!side.local) {
    const auto topic = frames.topic_text();
    const bool wanted = std::any_of(remote_prefixes_.begin(), remote_prefixes_.end(),
                                    [&](const auto& prefix) { return topic.starts_with(prefix); });
    if (!wanted) return;
    if (has_slab_tensors(header)) return send_inlined(frames);
  }
  bus::send_frames(side.xpub, frames.share());
}

void Relay::send_inlined(const bus::Frames& frames) {
  try {
    auto inlined = inline_slab_tensors(frames, find_slab_);
    if (inlined) {
      ++inlined_;
      bus::send_frames(remote_.xpub, std::move(*inlined));
    } else {
      ++inline_dropped_;
    }
  } catch (const bus::Error& error) {
    refuse(frames, error.what());
  }
}

void Relay::read_subscriptions(Side& side) {
  zmq::message_t event;
  while (side.xpub.recv(event, zmq::recv_flags::dontwait)) {
    if (event.empty() || event.size() > bus::max_topic_bytes + 1) continue;
    const auto kind = *event.data<std::uint8_t>();
    if (kind > 1) continue;
    const auto prefix = event.to_string().substr(1);
    if (!side.local && kind == 1) remote_prefixes_.insert(prefix);
    if (!side.local && kind == 0) remote_prefixes_.erase(prefix);
    if (kind == 1) resend_held(side, prefix);
  }
}

void Relay::resend_held(Side& side, const std::string& prefix) {
  for (auto& held : held_.matching(prefix)) send(side, held.frames, header_of(held.frames));
}

void Relay::tick() {
  const std::int64_t now = bus::now_ns();
  if (now < next_beat_ns_) return;
  next_beat_ns_ = now + beat_ns;
  relay(own_.heartbeat(statistics(), wire::ServiceState::Running), true);
  for (const auto& source : liveness_.update(now)) held_.erase(std::string(topics::kHeartbeat.name), source);
  const bool due = now >= next_report_ns_;
  if (liveness_.take_changed() || due) relay(own_.liveness(liveness_.nodes()), true);
  if (!due) return;
  next_report_ns_ = now + report_ns;
  relay(own_.topics(topics_), true);
}

void Relay::refuse(const bus::Frames& frames, const std::string& why) {
  ++malformed_;
  if (!limiter_.allow()) return;
  spdlog::warn("{}: dropped a malformed message ({} so far): {}", bus::printable(frames.topic_text()),
               malformed_.load(), why);
}

}  // namespace splatbus::bus_service
