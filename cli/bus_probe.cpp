#include "bus_probe.h"

#include <fmt/format.h>
#include <netdb.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>

#include <cerrno>
#include <cstring>
#include <memory>
#include <string>
#include <thread>

#include "bus/error.h"
#include "bus/file_descriptor.h"

namespace splatbus::cli {

namespace {

constexpr int kTcpPatienceMs = 3000;
constexpr std::chrono::milliseconds kLookAgainAfter(100);

[[noreturn]] void refuse(const bus::Address& address, const std::string& why) {
  throw bus::Error(fmt::format("no bus at {}: {}", address.text(), why));
}

void probe_local(const bus::Address& address) {
  const std::string path = address.slab_socket();
  const bus::FileDescriptor socket(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0));
  sockaddr_un name{};
  name.sun_family = AF_UNIX;
  path.copy(name.sun_path, sizeof name.sun_path - 1);
  if (::connect(socket.get(), reinterpret_cast<const sockaddr*>(&name), sizeof name) == 0) return;
  const bool nobody = errno == ENOENT || errno == ECONNREFUSED;
  refuse(address, nobody ? "nothing runs there; start it with 'splatbus launch', or give --bus or SPLATBUS_BUS"
                         : std::strerror(errno));
}

void probe_tcp(const bus::Address& address) {
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  const int error = ::getaddrinfo(address.host.c_str(), std::to_string(address.port).c_str(), &hints, &found);
  if (error != 0) refuse(address, ::gai_strerror(error));
  const std::unique_ptr<addrinfo, decltype(&::freeaddrinfo)> owner(found, &::freeaddrinfo);
  int reason = ECONNREFUSED;
  for (const addrinfo* candidate = found; candidate != nullptr; candidate = candidate->ai_next) {
    const bus::FileDescriptor socket(
        ::socket(candidate->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, candidate->ai_protocol));
    if (::connect(socket.get(), candidate->ai_addr, candidate->ai_addrlen) == 0) return;
    reason = errno;
    if (reason != EINPROGRESS) continue;
    pollfd connected{.fd = socket.get(), .events = POLLOUT, .revents = 0};
    reason = ETIMEDOUT;
    if (::poll(&connected, 1, kTcpPatienceMs) <= 0) continue;
    socklen_t bytes = sizeof reason;
    ::getsockopt(socket.get(), SOL_SOCKET, SO_ERROR, &reason, &bytes);
    if (reason == 0) return;
  }
  refuse(address, std::strerror(reason));
}

}  // namespace

void require_bus(const bus::Address& address) {
  if (address.is_local()) {
    probe_local(address);
  } else {
    probe_tcp(address);
  }
}

void require_bus(const bus::Address& address, std::chrono::duration<double> wait, const std::stop_token& stop) {
  const auto end = std::chrono::steady_clock::now() + wait;
  for (;;) {
    try {
      return require_bus(address);
    } catch (const bus::Error&) {
      if (stop.stop_requested() || std::chrono::steady_clock::now() >= end) throw;
    }
    std::this_thread::sleep_for(kLookAgainAfter);
  }
}

}  // namespace splatbus::cli
