#include "bus/subscriber.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <deque>
#include <map>
#include <optional>
#include <string_view>
#include <tuple>
#include <utility>

#include "bus/clock.h"
#include "bus/context_impl.h"
#include "bus/frames.h"
#include "bus/log_sink.h"
#include "bus/token_bucket.h"

namespace splatbus::bus {
namespace {

constexpr auto broker_topic = topics::kLiveness.name;
constexpr std::size_t max_tracked = 65536;  // streams that one subscriber remembers
constexpr std::size_t max_drained = 10000;  // messages that one receive_newest() takes

std::string latch_key_of(const wire::Header& header) {
  return header.latch_key() == nullptr ? std::string() : header.latch_key()->str();
}

/// Of a source and a topic, found by views of them.
struct StreamLess {
  using is_transparent = void;
  using Names = std::pair<std::string_view, std::string_view>;
  template <class A, class B>
  bool operator()(const A& a, const B& b) const {
    return Names(a.first, a.second) < Names(b.first, b.second);
  }
};

struct Position {
  std::uint64_t epoch = 0;
  std::uint64_t sequence = 0;
  bool live = false;  // something that the broker did not hold has come
};

}  // namespace

struct Subscriber::Impl {
  std::shared_ptr<Context> context;
  zmq::socket_t socket;
  std::vector<std::string> exact;
  std::vector<std::string> prefixes;
  std::map<std::pair<std::string, std::string>, Position, StreamLess> positions;  // source, topic
  std::map<std::tuple<std::string, std::string, std::string>, Position> latched;  // source, topic, latch key
  std::deque<std::shared_ptr<Message::Content>> early;                            // came during wait_connected()
  std::map<std::string, std::function<void(const Message&)>, std::less<>> handlers;
  std::map<std::pair<std::string, std::string>, LogLimiter> refusal_limiters;  // topic, source
  TokenBucket refusals_said{5, 20};                                            // of all: a peer has many names
  std::uint64_t lost = 0;
  std::uint64_t malformed = 0;
  std::uint64_t refused = 0;
  LogLimiter limiter;

  Impl(std::shared_ptr<Context> bus, const std::vector<std::string>& topics)
      : context(std::move(bus)), socket(context->impl_->zmq, zmq::socket_type::sub) {
    configure_socket(socket, context->address().is_local());
    for (const auto& topic : topics) {
      const bool prefix = topic.ends_with('*');
      const auto name = prefix ? topic.substr(0, topic.size() - 1) : topic;
      (prefix ? prefixes : exact).push_back(name);
      socket.set(zmq::sockopt::subscribe, name);
    }
    if (context->impl_->keys) use_keys(socket, *context->impl_->keys);
    socket.connect(context->address().subscribe_endpoint());
  }

  // ZeroMQ matches prefixes only.
  [[nodiscard]] bool wanted(std::string_view topic) const {
    return std::any_of(exact.begin(), exact.end(), [&](const auto& name) { return topic == name; }) ||
           std::any_of(prefixes.begin(), prefixes.end(), [&](const auto& name) { return topic.starts_with(name); });
  }

  void refuse(const Frames& frames, const std::string& why) {
    ++malformed;
    if (limiter.allow()) {
      spdlog::warn("{}: skipped a malformed message ({} so far): {}", printable(frames.topic_text()), malformed, why);
    }
  }

  [[nodiscard]] bool seen_before(const std::string& topic, const wire::Header& header) {
    if (!header.latch()) return false;
    if (latched.size() >= max_tracked) latched.clear();
    auto& position = latched[{header.source()->str(), topic, latch_key_of(header)}];
    if (position.epoch == header.epoch() && header.sequence() <= position.sequence) return true;
    position = {header.epoch(), header.sequence(), true};
    return false;
  }

  Position& position_of(std::string_view source, std::string_view topic) {
    const auto found = positions.find(StreamLess::Names(source, topic));
    if (found != positions.end()) return found->second;
    if (positions.size() >= max_tracked) positions.clear();
    return positions[{std::string(source), std::string(topic)}];
  }

  void count_gap(std::string_view topic, const wire::Header& header) {
    Position& position = position_of(header.source()->string_view(), topic);
    if (position.epoch != header.epoch()) position = {header.epoch(), 0, false};
    const bool live = !header.resent();
    if (live && position.live && header.sequence() > position.sequence + 1) {
      lost += header.sequence() - position.sequence - 1;
    }
    position.sequence = std::max(position.sequence, header.sequence());
    position.live = position.live || live;
  }

  // Subscriptions are handled in order, and what the broker holds is sent when one arrives: its own word, asked for
  // last, says that the others are in place.
  bool wait_connected(std::int64_t deadline) {
    socket.set(zmq::sockopt::subscribe, broker_topic);
    bool connected = false;
    while (!connected) {
      auto content = std::make_shared<Message::Content>();
      std::string why;
      const RecvResult result = receive_frames(socket, content->frames, why);
      if (result == RecvResult::Nothing) {
        if (!wait_readable(deadline)) break;
      } else if (result == RecvResult::Malformed) {
        refuse(content->frames, why);
      } else {
        connected = content->frames.topic_text() == broker_topic;
        early.push_back(std::move(content));
      }
    }
    socket.set(zmq::sockopt::unsubscribe, broker_topic);
    return connected;
  }

  // False at the deadline, and when a signal arrives.
  bool wait_readable(std::int64_t deadline) {
    const std::int64_t left_ns = deadline - now_ns();
    if (left_ns <= 0) return false;
    zmq_pollitem_t item{socket.handle(), 0, ZMQ_POLLIN, 0};
    return zmq_poll(&item, 1, static_cast<long>((left_ns + 999'999) / 1'000'000)) >= 0;
  }

  std::shared_ptr<Message::Content> next_complete() {
    while (true) {
      if (!early.empty()) {
        auto content = std::move(early.front());
        early.pop_front();
        return content;
      }
      auto content = std::make_shared<Message::Content>();
      std::string why;
      const RecvResult result = receive_frames(socket, content->frames, why);
      if (result == RecvResult::Complete) return content;
      if (result == RecvResult::Nothing) return nullptr;
      refuse(content->frames, why);
    }
  }

  // The next message that is there and concerns the caller.
  std::shared_ptr<Message::Content> take(const wire::Header*& header, std::string& topic) {
    while (auto content = next_complete()) {
      if (!wanted(content->frames.topic_text())) continue;
      std::string why;
      header = verified_header(content->frames.body, why);
      if (header == nullptr) {
        refuse(content->frames, why);
        continue;
      }
      topic = content->frames.topic_text();
      if (seen_before(topic, *header)) continue;
      count_gap(topic, *header);
      return content;
    }
    return nullptr;
  }
};

Subscriber::Subscriber(std::shared_ptr<Context> context, const std::vector<std::string>& topics)
    : impl_(std::make_unique<Impl>(std::move(context), topics)) {}
Subscriber::~Subscriber() = default;
Subscriber::Subscriber(Subscriber&&) noexcept = default;
Subscriber& Subscriber::operator=(Subscriber&&) noexcept = default;

bool Subscriber::wait_connected(std::chrono::milliseconds timeout) {
  return impl_->wait_connected(now_ns() + std::chrono::nanoseconds(timeout).count());
}

std::optional<Message> Subscriber::receive(std::chrono::milliseconds timeout) {
  std::optional<std::int64_t> deadline;
  while (true) {
    Message message;
    message.content_ = impl_->take(message.header_, message.topic_);
    if (message.content_ != nullptr) {
      message.context_ = impl_->context;
      return message;
    }
    if (timeout.count() <= 0) return std::nullopt;
    if (!deadline) deadline = now_ns() + std::chrono::nanoseconds(timeout).count();
    if (!impl_->wait_readable(*deadline)) return std::nullopt;
  }
}

std::vector<Message> Subscriber::receive_newest(std::chrono::milliseconds timeout) {
  std::vector<Message> received;
  for (auto message = receive(timeout); message; message = receive(std::chrono::milliseconds(0))) {
    received.push_back(std::move(*message));
    if (received.size() >= max_drained) break;
  }
  return keep_newest(std::move(received));
}

void Subscriber::add_handler(std::string_view topic, std::function<void(const Message&)> handle) {
  impl_->handlers.insert_or_assign(std::string(topic), std::move(handle));
  impl_->exact.emplace_back(topic);
  impl_->socket.set(zmq::sockopt::subscribe, std::string(topic));
}

bool Subscriber::dispatch(const Message& message) {
  const auto found = impl_->handlers.find(message.topic());
  if (found == impl_->handlers.end()) return true;
  try {
    found->second(message);
    return true;
  } catch (const std::exception& error) {
    ++impl_->refused;
    auto& limiters = impl_->refusal_limiters;
    if (limiters.size() >= max_tracked) limiters.clear();
    const std::string source = message.header().source()->str();
    if (limiters[{message.topic(), source}].allow() && impl_->refusals_said.take(1, now_ns())) {
      spdlog::error("{} from {} (sequence {}) is refused, {} so far: {}", message.topic(), printable(source),
                    message.header().sequence(), impl_->refused, error.what());
    }
    return false;
  }
}

std::size_t Subscriber::dispatch_all(std::chrono::milliseconds timeout, std::size_t max_messages) {
  std::size_t taken = 0;
  for (auto message = receive(timeout); message; message = receive(std::chrono::milliseconds(0))) {
    dispatch(*message);
    if (++taken >= max_messages) break;
  }
  return taken;
}

std::size_t Subscriber::dispatch_newest(std::chrono::milliseconds timeout) {
  const auto messages = receive_newest(timeout);
  for (const Message& message : messages) dispatch(message);
  return messages.size();
}

std::vector<Message> keep_newest(std::vector<Message> messages) {
  std::map<std::tuple<std::string, std::string, std::string>, std::size_t> newest;
  const auto stream_of = [](const Message& message) {
    return std::tuple(message.topic(), message.header().source()->str(), latch_key_of(message.header()));
  };
  for (std::size_t i = 0; i < messages.size(); ++i) newest[stream_of(messages[i])] = i;
  std::vector<Message> result;
  result.reserve(newest.size());
  for (std::size_t i = 0; i < messages.size(); ++i) {
    if (newest.at(stream_of(messages[i])) == i) result.push_back(std::move(messages[i]));
  }
  return result;
}

std::uint64_t Subscriber::lost() const {
  return impl_->lost;
}
std::uint64_t Subscriber::malformed() const {
  return impl_->malformed;
}
std::uint64_t Subscriber::refused() const {
  return impl_->refused;
}
void* Subscriber::zmq_socket() const {
  return impl_->socket.handle();
}

}  // namespace splatbus::bus
