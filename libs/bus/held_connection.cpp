#include "bus/held_connection.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <array>
#include <mutex>
#include <set>
#include <utility>

#include "bus/peer_socket.h"

namespace splatbus::bus {
namespace {

struct Numbers {
  std::mutex mutex;
  std::set<int> held;
};

Numbers& numbers() {
  static Numbers all;
  return all;
}

}  // namespace

HeldConnection HeldConnection::of(int fd) {
  const std::scoped_lock lock(numbers().mutex);
  FileDescriptor held(::fcntl(fd, F_DUPFD_CLOEXEC, 0));
  if (held.valid()) numbers().held.insert(held.get());
  return HeldConnection(std::move(held));
}

bool HeldConnection::has(int fd) {
  const std::scoped_lock lock(numbers().mutex);
  return numbers().held.contains(fd);
}

HeldConnection& HeldConnection::operator=(HeldConnection&& other) noexcept {
  close();
  fd_ = std::move(other.fd_);
  return *this;
}

void HeldConnection::close() {
  if (!fd_.valid()) return;
  const std::scoped_lock lock(numbers().mutex);
  numbers().held.erase(fd_.get());
  fd_.reset();
}

std::uint64_t HeldConnection::cookie() const {
  return cookie_of(fd_.get());
}

std::optional<tcp_info> HeldConnection::info() const {
  tcp_info info{};
  socklen_t size = sizeof(info);
  if (::getsockopt(fd_.get(), IPPROTO_TCP, TCP_INFO, &info, &size) != 0) return std::nullopt;
  return info;
}

void HeldConnection::detach_filter() const {
  const int none = 0;
  ::setsockopt(fd_.get(), SOL_SOCKET, SO_DETACH_FILTER, &none, sizeof(none));
}

void HeldConnection::shut(int fd) {
  const linger none{1, 0};
  ::setsockopt(fd, SOL_SOCKET, SO_LINGER, &none, sizeof(none));
  ::shutdown(fd, SHUT_RDWR);
}

std::string address_of(int fd) {
  sockaddr_storage peer{};
  socklen_t size = sizeof(peer);
  if (::getpeername(fd, reinterpret_cast<sockaddr*>(&peer), &size) != 0) return {};
  std::array<char, INET6_ADDRSTRLEN> text{};
  const void* address = nullptr;
  if (peer.ss_family == AF_INET) address = &reinterpret_cast<const sockaddr_in&>(peer).sin_addr;
  if (peer.ss_family == AF_INET6) address = &reinterpret_cast<const sockaddr_in6&>(peer).sin6_addr;
  if (address == nullptr || ::inet_ntop(peer.ss_family, address, text.data(), text.size()) == nullptr) return {};
  return text.data();
}

}  // namespace splatbus::bus
