#include "probe_runner.h"

#include <netdb.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <memory>
#include <string>
#include <utility>

#include "bus/file_descriptor.h"
#include "child_process.h"

namespace splatbus::cli {

namespace {

using Time = std::chrono::steady_clock::time_point;
constexpr int kSliceMs = 20;  // between looks at whether to stop

/// One attempt's end.
struct Limit {
  std::stop_token stop;
  Time until;
  [[nodiscard]] bool is_over() const { return stop.stop_requested() || std::chrono::steady_clock::now() >= until; }
};

/// False when it is not within the limit.
bool wait_for(int descriptor, short events, const Limit& limit) {
  while (!limit.is_over()) {
    pollfd one{.fd = descriptor, .events = events, .revents = 0};
    if (::poll(&one, 1, kSliceMs) > 0) return true;
  }
  return false;
}

bus::FileDescriptor connect_to(const std::string& host, const std::string& port, const Limit& limit) {
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (::getaddrinfo(host.c_str(), port.c_str(), &hints, &found) != 0) return {};
  const std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)> addresses(found, ::freeaddrinfo);
  for (const addrinfo* at = found; at != nullptr; at = at->ai_next) {
    bus::FileDescriptor socket(::socket(at->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
    if (socket.get() < 0) continue;
    if (::connect(socket.get(), at->ai_addr, at->ai_addrlen) != 0) {
      int error = errno;
      socklen_t size = sizeof error;
      if (error != EINPROGRESS || !wait_for(socket.get(), POLLOUT, limit)) continue;
      if (::getsockopt(socket.get(), SOL_SOCKET, SO_ERROR, &error, &size) != 0 || error != 0) continue;
    }
    return socket;
  }
  return {};
}

/// "host:port" and "[::1]:port"; `port` where there is none.
std::pair<std::string, std::string> host_and_port(const std::string& text, const std::string& port) {
  const std::size_t bracket = text.rfind(']'), colon = text.rfind(':');
  const bool has_port = colon != std::string::npos && (bracket == std::string::npos || colon > bracket);
  std::string host = text.substr(0, has_port ? colon : std::string::npos);
  if (host.size() > 1 && host.front() == '[' && host.back() == ']') host = host.substr(1, host.size() - 2);
  return {host, has_port ? text.substr(colon + 1) : port};
}

bool try_tcp(const std::string& target, const Limit& limit) {
  const auto [host, port] = host_and_port(target, "");
  return connect_to(host, port, limit).get() >= 0;
}

bool try_http(const std::string& url, const Limit& limit) {
  const std::string place = url.substr(url.find("//") + 2);
  const std::size_t slash = std::min(place.find('/'), place.size());
  const auto [host, port] = host_and_port(place.substr(0, slash), "80");
  const bus::FileDescriptor socket = connect_to(host, port, limit);
  if (socket.get() < 0) return false;
  const std::string path = slash < place.size() ? place.substr(slash) : "/";
  const std::string request =
      "GET " + path + " HTTP/1.1\r\nHost: " + place.substr(0, slash) + "\r\nConnection: close\r\n\r\n";
  if (::send(socket.get(), request.data(), request.size(), MSG_NOSIGNAL) != static_cast<ssize_t>(request.size())) {
    return false;
  }
  const std::size_t needed = std::string_view("HTTP/1.1 200").size();
  std::string status;
  while (status.size() < needed && wait_for(socket.get(), POLLIN, limit)) {
    char bytes[64];
    const ssize_t got = ::recv(socket.get(), bytes, needed - status.size(), 0);
    if (got <= 0) return false;
    status.append(bytes, static_cast<std::size_t>(got));
  }
  return status.size() == needed && status.starts_with("HTTP/1.") && (status[9] == '2' || status[9] == '3');
}

bool try_command(const std::vector<std::string>& command, const Limit& limit) {
  try {
    ChildProcess child("/usr/bin/env", command, {});  // which finds it by PATH
    while (!limit.is_over()) {
      static_cast<void>(child.read_lines(true));
      if (const auto exit = child.poll_exit()) return exit->success();
      pollfd ends{.fd = child.exit_fd(), .events = POLLIN, .revents = 0};
      ::poll(&ends, 1, kSliceMs);
    }
  } catch (const std::runtime_error&) {  // it cannot be started
  }
  return false;
}

bool attempt(const Probe& probe, const Limit& limit) {
  switch (probe.kind) {
    case Probe::Kind::Tcp:
      return try_tcp(probe.target, limit);
    case Probe::Kind::Http:
      return try_http(probe.target, limit);
    case Probe::Kind::Command:
      return try_command(probe.command, limit);
  }
  return false;
}

}  // namespace

ProbeRunner::ProbeRunner(const Probe& probe)
    : probe_(probe), thread_([this](const std::stop_token& stop) { run(stop); }) {}

void ProbeRunner::run(const std::stop_token& stop) {
  using Seconds = std::chrono::duration<double>;
  using Clock = std::chrono::steady_clock;
  while (!stop.stop_requested()) {
    const Time start = Clock::now();
    const auto after = [&](double seconds) {
      return start + std::chrono::duration_cast<Clock::duration>(Seconds(seconds));
    };
    if (attempt(probe_, {stop, after(probe_.timeout_s)})) {
      failed_ = 0;
      was_good_ = true;
    } else if (!stop.stop_requested()) {
      ++failed_;
    }
    const Time next = after(probe_.period_s);
    while (!stop.stop_requested() && Clock::now() < next)
      std::this_thread::sleep_for(std::chrono::milliseconds(kSliceMs));
  }
}

}  // namespace splatbus::cli
