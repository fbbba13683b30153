#include "tcp_relay.h"

#include <arpa/inet.h>
#include <fmt/format.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <stdexcept>

#include "bus/clock.h"

namespace splatbus::cli {

namespace {

constexpr std::int64_t kLongestWaitNs = 100'000'000;
// A viewer gives a try to connect up after a second, and begins another one half a second later at most.
constexpr std::int64_t kTryNs = 1'500'000'000;
constexpr std::int64_t kGoneNs = 5'000'000'000;  // of bus::watch_connections(): both ends give up in a longer cut
constexpr int kBufferBytes = 1 << 16;            // what waits for a slow link waits at its sender

bus::FileDescriptor make_socket() {
  bus::FileDescriptor made(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!made.valid()) throw std::runtime_error(fmt::format("cannot make a socket: {}", std::strerror(errno)));
  return made;
}

sockaddr_in loopback(std::uint16_t port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  return address;
}

std::uint16_t listen_anywhere(const bus::FileDescriptor& listener) {
  sockaddr_in address = loopback(0);
  auto* generic = reinterpret_cast<sockaddr*>(&address);
  socklen_t bytes = sizeof address;
  if (::bind(listener.get(), generic, bytes) != 0 || ::listen(listener.get(), 64) != 0 ||
      ::getsockname(listener.get(), generic, &bytes) != 0) {
    throw std::runtime_error(fmt::format("cannot listen on the loopback address: {}", std::strerror(errno)));
  }
  return ntohs(address.sin_port);
}

void tune(int fd) {
  const int on = 1;
  ::setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
}

bool waits() {
  return errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR || errno == ENOTCONN || errno == EINPROGRESS;
}

}  // namespace

std::uint16_t free_loopback_port() {
  return listen_anywhere(make_socket());
}

TcpRelay::TcpRelay(std::uint16_t to_port, const LinkShape& shape, std::uint64_t seed)
    : to_port_(to_port),
      shape_(shape),
      seed_(seed),
      listener_(make_socket()),
      wake_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
  // Inherited by what is accepted.
  ::setsockopt(listener_.get(), SOL_SOCKET, SO_RCVBUF, &kBufferBytes, sizeof kBufferBytes);
  port_ = listen_anywhere(listener_);
  thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

TcpRelay::~TcpRelay() {
  thread_.request_stop();
  ::eventfd_write(wake_.get(), 1);
}

void TcpRelay::cut(const LinkCut& cut) {
  std::unique_lock lock(mutex_);
  cut_ = cut;
  cut_is_new_ = true;
  ::eventfd_write(wake_.get(), 1);
  cut_known_.wait(lock, [this] { return !cut_is_new_; });
}

void TcpRelay::run(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    eventfd_t count = 0;
    (void)::eventfd_read(wake_.get(), &count);
    const std::int64_t now_ns = bus::now_ns();
    {
      const std::scoped_lock lock(mutex_);
      for (const auto& connection : connections_) {
        connection->up.schedule.cut(cut_);
        connection->down.schedule.cut(cut_);
      }
      const bool is_long = cut_.contains(now_ns) && now_ns - cut_.from_ns >= kGoneNs;
      std::erase_if(connections_,
                    [&](const auto& connection) { return is_long && connection->open_ns < cut_.from_ns; });
      cut_is_new_ = false;
      cut_known_.notify_all();
    }
    accept_all(now_ns);
    std::erase_if(connections_, [&](const auto& connection) { return !serve(*connection, now_ns); });
    wait(now_ns);
  }
}

void TcpRelay::accept_all(std::int64_t now_ns) {
  while (true) {
    bus::FileDescriptor client(::accept4(listener_.get(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
    if (!client.valid()) return;
    tune(client.get());
    const auto round_trip_ns = static_cast<std::int64_t>(shape_.round_trip_ms * 1e6);
    const std::scoped_lock lock(mutex_);
    std::int64_t open_ns = now_ns;
    while (cut_.contains(open_ns)) open_ns += kTryNs;
    auto connection = std::make_unique<Connection>(Connection{.client = std::move(client),
                                                              .server = {},
                                                              .open_ns = open_ns + round_trip_ns,
                                                              .up = {.schedule = LinkSchedule(shape_, seed_++)},
                                                              .down = {.schedule = LinkSchedule(shape_, seed_++)}});
    connection->up.schedule.cut(cut_);
    connection->down.schedule.cut(cut_);
    connections_.push_back(std::move(connection));
  }
}

bool TcpRelay::serve(Connection& connection, std::int64_t now_ns) {
  if (now_ns < connection.open_ns) return true;
  if (!connection.server.valid()) {
    connection.server = make_socket();
    ::setsockopt(connection.server.get(), SOL_SOCKET, SO_RCVBUF, &kBufferBytes, sizeof kBufferBytes);
    tune(connection.server.get());
    const sockaddr_in address = loopback(to_port_);
    if (::connect(connection.server.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 &&
        errno != EINPROGRESS) {
      return false;
    }
  }
  const int client = connection.client.get(), server = connection.server.get();
  if (!read_all(connection.up, client, now_ns) || !read_all(connection.down, server, now_ns)) return false;
  if (!write_due(connection.up, server, now_ns) || !write_due(connection.down, client, now_ns)) return false;
  return !(connection.up.done && connection.down.done);
}

bool TcpRelay::read_all(Way& way, int from, std::int64_t now_ns) {
  std::array<std::byte, LinkSchedule::kSegmentBytes> buffer;
  while (!way.ended && !way.schedule.full(way.bytes, now_ns)) {
    const ssize_t got = ::recv(from, buffer.data(), buffer.size(), 0);
    if (got < 0 && waits()) return true;
    const std::size_t bytes = got > 0 ? static_cast<std::size_t>(got) : 0;
    way.ended = got <= 0;
    way.bytes += bytes;
    way.segments.push_back(
        {.bytes = {buffer.data(), buffer.data() + bytes}, .written = 0, .there_ns = way.schedule.send(bytes, now_ns)});
  }
  return true;
}

bool TcpRelay::write_due(Way& way, int to, std::int64_t now_ns) {
  while (!way.segments.empty() && way.segments.front().there_ns <= now_ns) {
    Segment& segment = way.segments.front();
    if (segment.bytes.empty()) {
      ::shutdown(to, SHUT_WR);
      way.done = true;
    } else {
      const ssize_t put =
          ::send(to, segment.bytes.data() + segment.written, segment.bytes.size() - segment.written, MSG_NOSIGNAL);
      if (put < 0) return waits();
      segment.written += static_cast<std::size_t>(put);
      if (segment.written < segment.bytes.size()) return true;
      way.bytes -= segment.bytes.size();
    }
    way.segments.pop_front();
  }
  return true;
}

void TcpRelay::wait(std::int64_t now_ns) {
  std::int64_t until_ns = now_ns + kLongestWaitNs;
  std::vector<pollfd> items{{listener_.get(), POLLIN, 0}, {wake_.get(), POLLIN, 0}};
  for (const auto& connection : connections_) {
    if (!connection->server.valid()) {
      until_ns = std::min(until_ns, connection->open_ns);
      continue;
    }
    pollfd client{connection->client.get(), 0, 0}, server{connection->server.get(), 0, 0};
    const auto plan = [&](const Way& way, pollfd& from, pollfd& to) {
      // What is full empties with time alone.
      if (!way.ended && !way.schedule.full(way.bytes, now_ns)) from.events |= POLLIN;
      if (!way.ended && way.schedule.full(way.bytes, now_ns)) until_ns = std::min(until_ns, now_ns + 5'000'000);
      if (way.segments.empty()) return;
      const std::int64_t there_ns = way.segments.front().there_ns;
      if (there_ns <= now_ns) {
        to.events |= POLLOUT;
      } else {
        until_ns = std::min(until_ns, there_ns);
      }
    };
    plan(connection->up, client, server);
    plan(connection->down, server, client);
    for (const pollfd& item : {client, server}) {
      if (item.events != 0) items.push_back(item);
    }
  }
  // In nanoseconds: at 20 Mbit/s a segment takes half a millisecond.
  const std::int64_t wait_ns = std::max<std::int64_t>(0, until_ns - bus::now_ns());
  const timespec timeout{.tv_sec = wait_ns / 1'000'000'000, .tv_nsec = wait_ns % 1'000'000'000};
  ::ppoll(items.data(), items.size(), &timeout, nullptr);
}

}  // namespace splatbus::cli
