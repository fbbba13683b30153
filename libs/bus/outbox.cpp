#include "bus/outbox.h"

#include <fmt/format.h>
#include <poll.h>
#include <sys/eventfd.h>

#include <utility>

#include "bus/clock.h"
#include "bus/error.h"
#include "bus/frames.h"

namespace splatbus::bus {
namespace {

constexpr std::size_t max_latched_messages = 8192;
constexpr std::size_t max_latched_bytes = std::size_t{256} << 20;
constexpr std::size_t max_pending_messages = 512;
constexpr std::size_t max_pending_bytes = std::size_t{32} << 20;
constexpr int poll_ms = 100;     // a net below the edge-triggered ZMQ_FD
constexpr int held_poll_ms = 2;  // while slabs are being registered
constexpr std::int64_t longest_hold_ns = 1'000'000'000;
constexpr std::chrono::milliseconds linger{500};
constexpr std::int64_t read_period_ns = 1'000'000;  // while messages leave

}  // namespace

Outbox::Outbox(zmq::context_t& context, const Address& address, const std::optional<ClientKeys>& keys,
               SlabClient* slabs)
    : slabs_(slabs), socket_(context, zmq::socket_type::xpub), latched_(max_latched_messages, max_latched_bytes) {
  configure_socket(socket_, address.is_local());
  socket_.set(zmq::sockopt::xpub_verbose, true);
  // A pipe that lives only while connected: losing the broker shows as an unsubscription, and nothing piles up unseen.
  socket_.set(zmq::sockopt::immediate, true);
  if (keys) use_keys(socket_, *keys);
  socket_.connect(address.publish_endpoint());
  wake_ = FileDescriptor(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!wake_.valid()) throw Error("cannot make an eventfd");
  thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

Outbox::~Outbox() {
  close();
}

void Outbox::close() {
  {
    // A program that publishes one message and ends: give the broker that long to take it.
    std::unique_lock lock(mutex_);
    if (closed_) return;
    if (waiting_) connected_changed_.wait_for(lock, linger, [this] { return connected_; });
    if (reached_ && !connected_) {
      catch_up();  // late, rather than never
      connected_ = true;
    }
    closed_ = true;
  }
  thread_.request_stop();
  ::eventfd_write(wake_.get(), 1);
  thread_.join();
  const std::scoped_lock lock(mutex_);
  socket_.close();
  connected_ = false;
  pending_.clear();
  pending_bytes_ = 0;
}

std::uint64_t Outbox::send(Frames frames, const std::string* latch_key) {
  const std::scoped_lock lock(mutex_);
  if (closed_) return 0;
  read_subscriptions_if_due();
  const std::uint64_t sequence = ++sequence_of(frames.topic_text());
  auto* header =
      const_cast<wire::Header*>(flatbuffers::GetRoot<wire::Envelope>(frames.body.data())->header());  // NOLINT
  header->mutate_sequence(sequence);
  const std::uint64_t order = next_order_++;
  if (latch_key != nullptr) latched_.put(frames.topic.to_string(), *latch_key, "", order, frames.share());
  if (connected_) {
    send_frames(socket_, std::move(frames));
    return sequence;
  }
  waiting_ = true;
  if (latch_key == nullptr) {
    pending_bytes_ += frames.bytes();
    pending_.push_back({order, std::move(frames)});
    while (pending_.size() > max_pending_messages || pending_bytes_ > max_pending_bytes) {
      pending_bytes_ -= pending_.front().frames.bytes();
      pending_.pop_front();
    }
  }
  return sequence;
}

std::uint64_t& Outbox::sequence_of(std::string_view topic) {
  const auto found = sequences_.find(topic);
  return found != sequences_.end() ? found->second : sequences_[std::string(topic)];
}

bool Outbox::wait_connected(std::chrono::milliseconds timeout) {
  std::unique_lock lock(mutex_);
  return connected_changed_.wait_for(lock, timeout, [this] { return connected_; });
}

void Outbox::run(const std::stop_token& stop) {
  const int events = [this] {
    const std::scoped_lock lock(mutex_);
    return static_cast<int>(socket_.get(zmq::sockopt::fd));
  }();
  bool holds = false;
  while (!stop.stop_requested()) {
    pollfd fds[2] = {{events, POLLIN, 0}, {wake_.get(), POLLIN, 0}};
    ::poll(fds, 2, holds ? held_poll_ms : poll_ms);
    const std::scoped_lock lock(mutex_);
    read_subscriptions();
    holds = reached_ && !connected_;
  }
}

// To look and find nothing takes ZeroMQ several system calls, which would be most of what a small message costs.
void Outbox::read_subscriptions_if_due() {
  if (!connected_ || now_ns() - read_ns_ >= read_period_ns) read_subscriptions();
}

void Outbox::read_subscriptions() {
  read_ns_ = now_ns();
  zmq::message_t event;
  while (socket_.recv(event, zmq::recv_flags::dontwait)) {
    if (event.empty()) continue;
    const auto kind = *event.data<std::uint8_t>();
    if (kind > 1) continue;
    connected_ = false;
    reached_ = kind == 1;
    reached_ns_ = read_ns_;
    if (reached_ && slabs_ != nullptr) slabs_->look();
  }
  if (reached_ && !connected_) greet();
}

// A latched message is lost to a reader who hears of it before the broker knows the slab that it points into. Nothing
// is held for ever: where the registry takes no slabs, messages without any are worth more.
void Outbox::greet() {
  const bool registered = slabs_ == nullptr || slabs_->has_registered_all();
  if (!registered && now_ns() - reached_ns_ < longest_hold_ns) return;
  connected_ = true;
  catch_up();
  connected_changed_.notify_all();
}

void Outbox::catch_up() {
  auto latched = latched_.matching("");
  auto next_latched = latched.begin();
  const auto send_latched_before = [&](std::uint64_t order) {
    for (; next_latched != latched.end() && next_latched->order < order; ++next_latched) {
      send_frames(socket_, std::move(next_latched->frames));
    }
  };
  for (auto& waiting : pending_) {
    send_latched_before(waiting.order);
    send_frames(socket_, std::move(waiting.frames));
  }
  send_latched_before(next_order_);
  pending_.clear();
  pending_bytes_ = 0;
  waiting_ = false;
}

}  // namespace splatbus::bus
