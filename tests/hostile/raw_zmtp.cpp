#include "raw_zmtp.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <stdexcept>

namespace splatbus::hostile {

namespace {

constexpr int kPatienceMs = 2000;
constexpr std::size_t kGreetingBytes = 64;
constexpr std::uint8_t kMore = 1, kLong = 2, kCommand = 4;

std::string frame_head(std::uint8_t flags, std::uint64_t bytes) {
  std::string head;
  if (bytes < 256 && (flags & kLong) == 0) {
    head += static_cast<char>(flags);
    head += static_cast<char>(bytes);
    return head;
  }
  head += static_cast<char>(flags | kLong);
  for (int shift = 56; shift >= 0; shift -= 8)
    head += static_cast<char>((bytes >> static_cast<unsigned>(shift)) & 255U);
  return head;
}

bus::FileDescriptor connect_tcp(const std::string& host, int port) {
  bus::FileDescriptor socket(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
  sockaddr_in address{};
  const timeval patience{kPatienceMs / 1000, 0};
  ::setsockopt(socket.get(), SOL_SOCKET, SO_SNDTIMEO, &patience, sizeof(patience));  // connect's as well
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  ::inet_pton(AF_INET, host.c_str(), &address.sin_addr);
  if (::connect(socket.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0) socket.reset();
  return socket;
}

bus::FileDescriptor connect_unix(const std::string& path) {
  bus::FileDescriptor socket(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::strncpy(address.sun_path, path.c_str(), sizeof(address.sun_path) - 1);
  if (::connect(socket.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0) socket.reset();
  return socket;
}

}  // namespace

RawZmtp::RawZmtp(const std::string& endpoint) {
  const std::string rest = endpoint.substr(6);
  if (endpoint.starts_with("ipc://")) {
    socket_ = connect_unix(rest);
  } else {
    const auto colon = rest.rfind(':');
    socket_ = connect_tcp(rest.substr(0, colon), std::stoi(rest.substr(colon + 1)));
  }
  if (!socket_.valid()) throw std::runtime_error(endpoint + ": " + std::strerror(errno));
  const timeval timeout{kPatienceMs / 1000, 0};
  ::setsockopt(socket_.get(), SOL_SOCKET, SO_SNDTIMEO, &timeout, sizeof(timeout));
  ::setsockopt(socket_.get(), SOL_SOCKET, SO_RCVTIMEO, &timeout, sizeof(timeout));
}

std::optional<RawZmtp> RawZmtp::try_connect(const std::string& endpoint) {
  try {
    return RawZmtp(endpoint);
  } catch (const std::runtime_error&) {
    return std::nullopt;
  }
}

bool RawZmtp::greet(const std::string& mechanism) {
  std::string greeting(kGreetingBytes, '\0');
  greeting[0] = '\xff';
  greeting[9] = '\x7f';
  greeting[10] = 3;
  greeting[11] = 1;
  std::ranges::copy(mechanism, greeting.begin() + 12);
  std::string answer;
  return send_bytes(greeting) && read_exactly(kGreetingBytes, answer);
}

bool RawZmtp::handshake(const std::string& socket_type) {
  std::string property = "\x0bSocket-Type";
  property += std::string(3, '\0') + static_cast<char>(socket_type.size()) + socket_type;
  if (!greet() || !send_command("READY", property)) return false;
  std::string head, body;
  return read_exactly(2, head) && read_exactly(static_cast<std::uint8_t>(head[1]), body) &&
         body.substr(1, 5) == "READY";
}

bool RawZmtp::send_frame(const std::string& bytes, bool more) {
  return send_bytes(frame_head(more ? kMore : 0, bytes.size()) + bytes);
}

bool RawZmtp::send_command(const std::string& name, const std::string& data) {
  std::string body(1, static_cast<char>(name.size()));
  body += name + data;
  return send_bytes(frame_head(kCommand, body.size()) + body);
}

bool RawZmtp::send_frame_head(std::uint64_t bytes, bool more) {
  return send_bytes(frame_head(static_cast<std::uint8_t>((more ? kMore : 0) | kLong), bytes));
}

bool RawZmtp::send_bytes(const std::string& bytes) {
  std::size_t sent = 0;
  while (sent < bytes.size()) {
    const ssize_t n = ::send(socket_.get(), bytes.data() + sent, bytes.size() - sent, MSG_NOSIGNAL);
    if (n <= 0) return false;
    sent += static_cast<std::size_t>(n);
  }
  return true;
}

void RawZmtp::reset() {
  const linger none{1, 0};
  ::setsockopt(socket_.get(), SOL_SOCKET, SO_LINGER, &none, sizeof(none));
  socket_ = bus::FileDescriptor();
}

bool RawZmtp::closed_within(std::chrono::milliseconds timeout) {
  const auto deadline = std::chrono::steady_clock::now() + timeout;
  while (true) {
    const auto left =
        std::chrono::duration_cast<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now());
    pollfd item{socket_.get(), POLLIN, 0};
    if (left.count() <= 0 || ::poll(&item, 1, static_cast<int>(left.count())) <= 0) return false;
    char buffer[4096];
    if (::recv(socket_.get(), buffer, sizeof(buffer), 0) <= 0) return true;
  }
}

std::string RawZmtp::read_some(std::size_t bytes, std::chrono::milliseconds timeout) {
  pollfd item{socket_.get(), POLLIN, 0};
  if (::poll(&item, 1, static_cast<int>(timeout.count())) <= 0) return {};
  std::string result(bytes, '\0');
  const ssize_t n = ::recv(socket_.get(), result.data(), bytes, 0);
  result.resize(n > 0 ? static_cast<std::size_t>(n) : 0);
  return result;
}

bool RawZmtp::read_exactly(std::size_t bytes, std::string& into) {
  into.clear();
  while (into.size() < bytes) {
    const std::string part = read_some(bytes - into.size(), std::chrono::milliseconds(kPatienceMs));
    if (part.empty()) return false;
    into += part;
  }
  return true;
}

void send_messages_and_pings(RawZmtp& raw, const std::string& message) {
  std::string bytes;
  for (int i = 0; i < 1000; ++i) bytes += frame_head(0, message.size()) + message;
  const std::string ping = std::string("\x04PING") + std::string(2, '\0');
  for (int i = 0; i < 200; ++i) bytes += frame_head(kCommand, ping.size()) + ping;
  raw.send_bytes(bytes);
}

}  // namespace splatbus::hostile
