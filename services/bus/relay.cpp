#include "bus/relay.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <sys/eventfd.h>

#include <algorithm>
#include <utility>

#include "bus/clock.h"
#include "bus/error.h"
#include "bus/frames.h"
#include "bus/heartbeat_check.h"
#include "bus/relay_messages.h"
#include "wire/topics.h"

namespace splatbus::bus_service {
namespace {

constexpr int messages_a_turn = 512;  // before the other sockets get theirs
constexpr std::int64_t beat_ns = 200'000'000;
constexpr std::int64_t report_ns = 1'000'000'000;
constexpr int subscriptions_a_turn = 256;
constexpr double share_of_a_source = 0.5;  // of what is held
constexpr std::int64_t remote_stamp = -1;  // of what came over tcp, whose clock is another
constexpr std::int64_t due_check_ms = 20;

}  // namespace

Relay::Relay(const BrokerOptions& options, FindSlab find_slab, std::function<std::size_t()> count_slabs)
    : count_slabs_(std::move(count_slabs)),
      local_{true, {zmq_, zmq::socket_type::xsub}, {zmq_, zmq::socket_type::xpub}},
      remote_{false, {zmq_, zmq::socket_type::xsub}, {zmq_, zmq::socket_type::xpub}},
      held_(options.max_held_messages, options.max_held_bytes, share_of_a_source),
      unsent_here_(options.max_remote_bytes),
      remote_readers_(std::move(find_slab), options.max_remote_bytes),
      wake_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
  if (!wake_.valid()) throw bus::Error("cannot make an eventfd");
  set_up_sockets(options);
  if (options.tcp_host) {
    guard_tcp(options);
    bind_tcp(options);
  }
  // Everything comes here whether or not somebody reads it: latched messages and heartbeats are kept.
  const std::uint8_t everything = 1;
  local_.xsub.send(zmq::buffer(&everything, 1));
  remote_.xsub.send(zmq::buffer(&everything, 1));
  waits_.add(wake_.get());
  waits_.add(remote_readers_.ready_fd());
  for (Side* side : {&local_, &remote_}) {
    side->xsub_wait = waits_.add(side->xsub);
    side->xpub_wait = waits_.add(side->xpub);
  }
  thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

Relay::~Relay() {
  thread_.request_stop();
  ::eventfd_write(wake_.get(), 1);
  thread_.join();
}

BrokerStatistics Relay::statistics() const {
  BrokerStatistics result;
  result.relayed = relayed_;
  result.malformed = malformed_;
  result.inlined = inlined_;
  result.inline_dropped = overwritten_ + left_out_;
  result.unheld = unheld_;
  result.held = held_count_;
  result.slabs = count_slabs_();
  return result;
}

void Relay::run(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    std::int64_t left_ms = std::max<std::int64_t>(0, (next_beat_ns_ - bus::now_ns()) / 1'000'000 + 1);
    if (remote_readers_.has_due()) left_ms = std::min(left_ms, due_check_ms);
    waits_.wait(static_cast<int>(left_ms));
    for (Side* side : {&local_, &remote_}) {
      if (waits_.readable(side->xpub_wait)) read_subscriptions(*side);
      if (waits_.readable(side->xsub_wait)) relay_from(*side);
    }
    resend_due();
    send_inlined();
    tick();
  }
  relay_own(own_.heartbeat(statistics(), wire::ServiceState::Stopping));
}

void Relay::relay_from(Side& side) {
  for (int i = 0; i < messages_a_turn; ++i) {
    bus::Frames frames;
    std::string why;
    const auto result = bus::receive_frames(side.xsub, frames, why);
    if (result == bus::RecvResult::Nothing) {
      if (!side.local && writers_guard_) writers_guard_->drained();
      return;
    }
    if (!side.local && writers_guard_) writers_guard_->took(frames.topic, frames.bytes());
    if (result == bus::RecvResult::Malformed) {
      refuse(frames, why);
    } else {
      take(frames, side.local);
    }
  }
  waits_.used(side.xsub_wait);  // there may be more
}

void Relay::take(bus::Frames& frames, bool local) {
  std::string why;
  const auto* const header = bus::verified_header(frames.body, why);
  if (header == nullptr) return refuse(frames, why);
  if (!local && !bus::sender_rights(frames.topic, allowed_.get()).control) {
    writers_guard_->close(frames.topic, "its key is not allowed to publish");
    return;
  }
  if (!local && has_slab_tensors(*header)) return refuse(frames, "a tensor in a slab cannot come over tcp");
  const bool heartbeat = frames.topic_text() == topics::kHeartbeat.name;
  flatbuffers::Verifier verifier(frames.body.data<std::uint8_t>(), frames.body.size(), 8, 4096);
  if (heartbeat) {
    if (!verifier.VerifyBuffer<wire::Heartbeat>(nullptr)) return refuse(frames, "it does not verify as a Heartbeat");
    why = heartbeat_problem(*flatbuffers::GetRoot<wire::Heartbeat>(frames.body.data()), frames.body.size());
    if (!why.empty()) return refuse(frames, why);
  }
  const std::int64_t now = bus::now_ns();
  const auto source = header->source()->string_view();
  if (!sources_.admit(source, header->epoch(), frames.topic, local, now, why)) {
    return refuse(frames, fmt::format("'{}': {}", bus::printable(source), why));
  }
  if (heartbeat) liveness_.note(*flatbuffers::GetRoot<wire::Heartbeat>(frames.body.data()), now, local);
  relay(frames, *header, now, local);
}

void Relay::relay(const bus::Frames& frames, const wire::Header& header, std::int64_t now, bool local) {
  if (header.latch() && !hold(frames, header, local)) return;
  ++relayed_;
  topics_.note(frames.topic_text(), header, frames.body.size(), now, local);
  send(local_, frames, header);
  send(remote_, frames, header);
}

void Relay::relay_own(const bus::Frames& frames) {
  relay(frames, header_of(frames), bus::now_ns(), true);
}

// Whether a latched message says what is known already, or less: publishers repeat theirs when a broker comes back, and
// a repeat may cross with something newer. Clocks and epochs compare on one machine only; what this machine's sources
// say is theirs while they are there.
bool Relay::is_stale(const wire::Header& header, const bus::LatchStore::Held& held, bool local) const {
  const auto& known = header_of(held.frames);
  const bool known_here = held.stamp != remote_stamp;
  const bool same_source = header.source()->string_view() == known.source()->string_view();
  if (local != known_here) return !local && sources_.speaks_here(known.source()->string_view());
  if (!same_source) return local && header.publish_ns() < held.stamp;
  if (header.epoch() == known.epoch()) return header.sequence() <= known.sequence();
  return local && header.epoch() < known.epoch();
}

bool Relay::hold(const bus::Frames& frames, const wire::Header& header, bool local) {
  const auto topic = frames.topic.to_string();
  const auto key = latch_key_of(header);
  const auto* known = held_.find(topic, key);
  if (known != nullptr && is_stale(header, *known, local)) return false;
  bus::Frames copy;
  copy.topic.rebuild(frames.topic.data(), frames.topic.size());
  copy.body.rebuild(frames.body.data(), frames.body.size());
  flatbuffers::GetMutableRoot<wire::Envelope>(copy.body.data())->mutable_header()->mutate_resent(true);
  // The tables of a hostile one overlap: what was written is then more than this field.
  if (std::string why; bus::verified_header(copy.body, why) == nullptr) {
    refuse(frames, why);
    return false;
  }
  if (frames.has_payload) {
    copy.payload.rebuild(frames.payload.data(), frames.payload.size());
    copy.has_payload = true;
  }
  // A publisher whose clock is ahead, by error or on purpose, shall not keep others out.
  const std::int64_t stamp = local ? std::clamp<std::int64_t>(header.publish_ns(), 0, bus::now_ns()) : remote_stamp;
  const auto source = header.source()->str();
  const auto put = held_.put(topic, key, source, next_order_++, std::move(copy), stamp, !local);
  if (!put.held) ++unheld_;
  if ((put.evicted > 0 || !put.held) && limiter_.allow()) {
    spdlog::warn("{} from {}: {}", bus::printable(topic), bus::printable(source),
                 put.held ? fmt::format("{} messages that were held gave way to it", put.evicted)
                          : fmt::format("its {} bytes are too many to be held for those who come later ({} so far)",
                                        frames.bytes(), unheld_.load()));
  }
  held_count_ = held_.size();
  return true;
}

void Relay::send_inlined() {
  for (auto& done : remote_readers_.take()) {
    if (!done.error.empty()) {
      refuse(done.frames, done.error);
    } else if (!done.complete) {
      ++overwritten_;
    } else {
      if (done.inlined) ++inlined_;
      send_on(remote_, std::move(done.frames));
    }
  }
}

void Relay::read_subscriptions(Side& side) {
  waits_.used(side.xpub_wait);  // there may be more
  zmq::message_t event;
  for (int i = 0; i < subscriptions_a_turn; ++i) {
    if (!side.xpub.recv(event, zmq::recv_flags::dontwait)) {
      if (!side.local && readers_guard_) readers_guard_->drained();
      return;
    }
    if (!side.local && readers_guard_) readers_guard_->took(event, event.size());
    if (event.size() > bus::max_topic_bytes + 1) {
      // libzmq keeps it all the same, for as long as the connection is there.
      if (!side.local && readers_guard_) readers_guard_->close(event, "it subscribes to something that is not a topic");
      continue;
    }
    if (event.empty()) continue;
    const auto kind = *event.data<std::uint8_t>();
    if (kind > 1) continue;
    const auto prefix = event.to_string().substr(1);
    if (side.local) {
      local_readers_.note(event, prefix, kind == 1);
      if (kind == 1) resend_held(side, prefix);
    } else if (kind == 0) {
      subscriptions_.end(event, prefix);
    } else if (subscriptions_.begin(event, prefix)) {
      remote_readers_.ask_for_held(prefix);
    } else if (readers_guard_) {
      readers_guard_->close(event, "it subscribes to more than there is room for");
    }
  }
}

std::set<std::string> Relay::readers_of(const std::string& topic) const {
  std::set<std::string> names = local_readers_.names(topic, liveness_.nodes());
  if (subscriptions_.wants(topic)) names.insert("tcp");
  return names;
}

void Relay::resend_held(Side& side, const std::string& prefix) {
  for (auto& held : held_.matching(prefix)) send(side, held.frames, header_of(held.frames));
}

// All that is held goes to all readers over tcp that want it, however many asked at once, and a few times a second.
void Relay::resend_due() {
  const auto due = remote_readers_.take_due(bus::now_ns());
  if (due.empty()) return;
  for (auto& held : held_.matching("")) {
    if (has_prefix_of(held.frames.topic_text(), due)) send(remote_, held.frames, header_of(held.frames));
  }
}

void Relay::tick() {
  const std::int64_t now = bus::now_ns();
  if (now < next_beat_ns_) return;
  next_beat_ns_ = now + beat_ns;
  relay_own(own_.heartbeat(statistics(), wire::ServiceState::Running));
  resend_missed(local_);
  resend_missed(remote_);
  make_room(now);
  if (writers_guard_) {  // the guards have to hear that the queues are empty even when nothing came
    relay_from(remote_);
    read_subscriptions(remote_);
  }
  sources_.forget_some();
  for (const auto& source : liveness_.update(now)) held_.erase(std::string(topics::kHeartbeat.name), source);
  const bool due = now >= next_report_ns_;
  if (liveness_.take_changed() || due) relay_own(own_.liveness(liveness_.nodes()));
  if (!due) return;
  next_report_ns_ = now + report_ns;
  local_readers_.forget_closed();
  subscriptions_.forget_closed();
  relay_own(own_.topics(topics_, [this](const std::string& topic) { return readers_of(topic); }));
}

void Relay::refuse(const bus::Frames& frames, const std::string& why) {
  ++malformed_;
  if (!limiter_.allow()) return;
  spdlog::warn("{}: dropped a malformed message ({} so far): {}", bus::printable(frames.topic_text()),
               malformed_.load(), why);
}

}  // namespace splatbus::bus_service
