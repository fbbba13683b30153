#include "bus/connection_guard.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <sys/eventfd.h>
#include <sys/resource.h>

#include <algorithm>
#include <atomic>
#include <cstring>
#include <utility>

#include "bus/clock.h"
#include "bus/curve.h"
#include "bus/error.h"
#include "bus/peer_socket.h"

namespace splatbus::bus {
namespace {

// Thousands of connections are looked at less often. The loopback device brings 20 MiB in 10 ms, so that what grows is
// looked at more often.
struct Pace {
  std::int64_t least_ns, of_one_ns;
};
constexpr Pace calm{10'000'000, 50'000}, hurried{2'000'000, 10'000};
constexpr std::uint64_t growing_bytes = std::uint64_t{1} << 20;
constexpr int idle_ms = 100;
constexpr std::size_t descriptors_for_others = 128;
constexpr std::size_t descriptors_a_connection = 4;  // libzmq's and ours, and a bus has two guards

struct Unread {
  std::uint64_t all = 0, largest = 0;
  int largest_fd = -1;

  void add(int fd, std::uint64_t bytes) {
    all += bytes;
    if (bytes < largest || bytes == 0) return;
    largest = bytes;
    largest_fd = fd;
  }
};

std::size_t room_for_connections(std::size_t wanted) {
  rlimit limit{};
  if (::getrlimit(RLIMIT_NOFILE, &limit) != 0) return wanted;
  const auto all = static_cast<std::size_t>(limit.rlim_cur);
  const std::size_t ours = all > 2 * descriptors_for_others ? all - descriptors_for_others : all / 2;
  return std::min(wanted, ours / descriptors_a_connection);
}

ConnectionLimits within_descriptors(ConnectionLimits limits) {
  limits.connections = room_for_connections(limits.connections);
  return limits;
}

}  // namespace

ConnectionGuard::ConnectionGuard(zmq::context_t& context, zmq::socket_t& socket, const ConnectionLimits& limits,
                                 std::string name)
    : limits_(within_descriptors(limits)),
      name_(std::move(name)),
      guarded_(socket),
      events_(context, zmq::socket_type::pair),
      wake_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
  if (!wake_.valid()) throw Error("cannot make an eventfd");
  static std::atomic<std::uint64_t> number = 0;
  const auto endpoint = fmt::format("inproc://splatbus-guard-{}", ++number);
  if (zmq_socket_monitor(socket.handle(), endpoint.c_str(), ZMQ_EVENT_LISTENING | ZMQ_EVENT_ACCEPTED) != 0)
    throw zmq::error_t();
  events_.set(zmq::sockopt::linger, 0);
  events_.set(zmq::sockopt::rcvhwm, 0);
  events_.connect(endpoint);
  thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

ConnectionGuard::~ConnectionGuard() {
  thread_.request_stop();
  ::eventfd_write(wake_.get(), 1);
  thread_.join();
  zmq_socket_monitor(guarded_.handle(), nullptr, 0);
}

void ConnectionGuard::took(const zmq::message_t& frame, std::size_t bytes) {
  const int fd = descriptor_of(frame);
  const std::scoped_lock lock(mutex_);
  const auto found = connections_.find(fd);
  // Where libzmq does not say by which connection it came, as with the end of a subscription, no byte came for it.
  const bool gone = found == connections_.end() ? fd >= 0 && cookie_of(fd) == 0 : found->second.closing;
  if (left_ + left_lately_ > 0 && gone) {
    for (std::uint64_t* left : {&left_, &left_lately_}) {
      const std::uint64_t less = std::min<std::uint64_t>(*left, bytes);
      *left -= less;
      bytes -= less;
    }
  }
  if (found == connections_.end()) return;
  found->second.taken = found->second.taken_lately = true;
  if (found->second.key.empty()) found->second.key = sender_key(frame);
}

void ConnectionGuard::close(const zmq::message_t& frame, const std::string& why) {
  const int fd = descriptor_of(frame);
  const std::scoped_lock lock(mutex_);
  if (const auto found = connections_.find(fd); found != connections_.end()) shut(found->second, why);
}

void ConnectionGuard::keep_only(std::function<bool(const std::string& key)> allowed) {
  const std::scoped_lock lock(mutex_);
  allowed_ = std::move(allowed);
}

ConnectionGuard::Counts ConnectionGuard::counts() const {
  const std::scoped_lock lock(mutex_);
  Counts counts = counts_;
  counts.open = connections_.size();
  return counts;
}

void ConnectionGuard::run(const std::stop_token& stop) {
  std::int64_t next_sweep = 0;
  std::size_t open = 0;
  bool door_open = true;
  while (!stop.stop_requested()) {
    const std::int64_t left_ns = open == 0 && door_open ? std::int64_t{idle_ms} * 1'000'000 : next_sweep - now_ns();
    zmq_pollitem_t items[] = {{events_.handle(), 0, ZMQ_POLLIN, 0}, {nullptr, wake_.get(), ZMQ_POLLIN, 0}};
    zmq_poll(items, std::size(items), static_cast<long>(std::clamp<std::int64_t>(left_ns / 1'000'000 + 1, 0, idle_ms)));
    const std::scoped_lock lock(mutex_);
    accept_events();
    const std::int64_t now = now_ns();
    if (now >= next_sweep) {
      const Pace& pace = sweep(now) > growing_bytes ? hurried : calm;
      next_sweep = now + std::max(pace.least_ns, static_cast<std::int64_t>(connections_.size()) * pace.of_one_ns);
    }
    open = connections_.size();
    door_open = door_.open();
  }
}

void ConnectionGuard::accept_events() {
  zmq::message_t event, endpoint;
  while (events_.recv(event, zmq::recv_flags::dontwait)) {
    (void)events_.recv(endpoint);
    if (event.size() < 6) continue;
    std::uint16_t what = 0;
    std::int32_t fd = -1;
    std::memcpy(&what, event.data(), sizeof(what));
    std::memcpy(&fd, event.data<std::uint8_t>() + sizeof(what), sizeof(fd));
    if (what == ZMQ_EVENT_LISTENING) {
      door_.add(fd);
    } else {
      begin(fd);
    }
  }
}

void ConnectionGuard::tend_door() {
  door_.set_open(limits_.all_left_bytes == 0 || left_ + left_lately_ <= limits_.all_left_bytes);
}

void ConnectionGuard::begin(int fd) {
  // Held numbers are no connections of libzmq's: it has closed this one, and the event is late.
  if (HeldConnection::has(fd)) return;
  const std::string address = address_of(fd);
  const std::uint64_t cookie = cookie_of(fd);
  if (address.empty() || cookie == 0) return;  // over ipc, or gone again
  if (const auto before = connections_.find(fd); before != connections_.end()) {
    if (before->second.cookie == cookie) return;
    count_left(before->second);
    connections_.erase(before);
  }
  Connection connection{.held = HeldConnection::of(fd), .cookie = cookie, .address = address};
  if (connection.held.cookie() != cookie) {
    // It is gone, or there is no descriptor left for it: what nobody looks at may not stay.
    if (cookie_of(fd) == cookie) HeldConnection::shut(fd);
    return;
  }
  connection.held.detach_filter();
  connection.since_ns = connection.heard_ns = now_ns();
  if (limits_.bytes_per_s > 0) connection.bytes = TokenBucket(limits_.bytes_per_s, limits_.burst_bytes);
  ++counts_.accepted;
  Connection& begun = connections_[fd] = std::move(connection);
  if (limits_.connections != 0 && connections_.size() > limits_.connections) {
    return shut(begun, fmt::format("more than {} connections", limits_.connections));
  }
  tend_door();
  if (!door_.open()) {
    return shut(begun, fmt::format("others left {} bytes that are still to be read", left_ + left_lately_));
  }
  const auto of_address = std::count_if(connections_.begin(), connections_.end(),
                                        [&](const auto& entry) { return entry.second.address == begun.address; });
  if (limits_.of_one_address != 0 && static_cast<std::size_t>(of_address) > limits_.of_one_address) {
    shut(begun, fmt::format("more than {} connections from one address", limits_.of_one_address));
  }
}

std::uint64_t ConnectionGuard::sweep(std::int64_t now) {
  const bool drained = drained_.exchange(false);
  if (drained) left_ = std::exchange(left_lately_, 0);
  tend_door();
  const bool check_keys = allowed_ && now >= next_key_check_ns_;
  if (check_keys) next_key_check_ns_ = now + to_ns(1);
  Unread unread, before_first;
  for (auto entry = connections_.begin(); entry != connections_.end();) {
    auto& [fd, connection] = *entry;
    if (cookie_of(fd) != connection.cookie) {
      count_left(connection);
      entry = connections_.erase(entry);
      continue;
    }
    std::string why;
    if (!look(connection, drained, now, why)) {
      shut(connection, why);
    } else if (check_keys && !connection.key.empty() && !allowed_(connection.key)) {
      shut(connection, "its key is not allowed any more");
    } else {
      unread.add(fd, connection.unread());
      if (!connection.taken) before_first.add(fd, connection.unread());
    }
    ++entry;
  }
  for (const auto& [sum, limit] :
       {std::pair(unread, limits_.all_unread_bytes), std::pair(before_first, limits_.all_first_unread_bytes)}) {
    if (limit == 0 || sum.all <= limit) continue;
    shut(connections_.at(sum.largest_fd),
         fmt::format("all connections together hold {} unread bytes, and it holds the most", sum.all));
  }
  return unread.largest;
}

bool ConnectionGuard::look(Connection& connection, bool drained, std::int64_t now, std::string& why) {
  if (connection.closing) return true;
  const auto info = connection.held.info();
  if (!info) return true;
  const std::uint64_t before = std::exchange(connection.received, info->tcpi_bytes_received);
  if (connection.taken_lately) connection.heard_ns = now;
  if (drained && std::exchange(connection.taken_lately, false)) {
    // What came before the last look is in that message, or was in the queue behind it.
    connection.read = before;
  }
  const std::uint64_t unread = connection.unread();
  const std::size_t limit =
      connection.taken || limits_.first_unread_bytes == 0 ? limits_.unread_bytes : limits_.first_unread_bytes;
  if (limit != 0 && unread > limit) {
    why = fmt::format("{} unread bytes: a message without an end, or more than is read", unread);
  } else if (limits_.bytes_per_s > 0 && connection.received > before &&
             !connection.bytes.take(static_cast<double>(connection.received - before), now)) {
    why = fmt::format("more than {} bytes a second", limits_.bytes_per_s);
  } else if (limits_.greeting_s > 0 && !connection.taken && now - connection.since_ns > to_ns(limits_.greeting_s)) {
    why = fmt::format("not a word in {} s", limits_.greeting_s);
  } else if (limits_.silence_s > 0 && connection.taken && now - connection.heard_ns > to_ns(limits_.silence_s)) {
    why = fmt::format("silent for {} s", limits_.silence_s);
  }
  // What is under way to a far reader says nothing about it: only what the kernel may not send does.
  look_at_sent(connection, info->tcpi_bytes_acked, info->tcpi_notsent_bytes > 0, now, why);
  return why.empty();
}

void ConnectionGuard::count_left(Connection& connection) {
  if (const auto info = connection.held.info()) {
    connection.received = std::max<std::uint64_t>(connection.received, info->tcpi_bytes_received);
  }
  left_lately_ += connection.unread();
  connection.read = connection.received;
}

void ConnectionGuard::shut(Connection& connection, const std::string& why) {
  if (connection.closing) return;
  connection.closing = true;
  ++counts_.closed;
  // libzmq gives back what was no whole message; the others wait for the owner as before.
  connection.held.shut();
  count_left(connection);
  if (limiter_.allow()) {
    spdlog::warn("{}: closed a connection from {} ({} so far): {}", name_, connection.address, counts_.closed, why);
  }
}

void raise_descriptor_limit() {
  rlimit limit{};
  if (::getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
  limit.rlim_cur = limit.rlim_max;
  ::setrlimit(RLIMIT_NOFILE, &limit);
}

}  // namespace splatbus::bus
