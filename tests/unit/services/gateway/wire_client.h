#pragma once

#include <arpa/inet.h>
#include <netinet/in.h>
#include <openssl/ssl.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <chrono>
#include <cstdint>
#include <cstring>
#include <memory>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "bus/file_descriptor.h"

namespace splatbus::gateway_test {

using namespace std::chrono_literals;
inline constexpr std::chrono::milliseconds kPatience = 60s;

/// A TCP connection to this machine, with TLS where that is asked for, that sends exactly the bytes that it is told to.
class WireClient {
 public:
  struct Options {
    bool tls = false;
    int receive_buffer = 0;  ///< bytes of the kernel's, 0: its own choice
  };
  explicit WireClient(std::uint16_t port) : WireClient(port, Options()) {}
  WireClient(std::uint16_t port, Options options) : socket_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    if (options.receive_buffer > 0) {
      ::setsockopt(socket_.get(), SOL_SOCKET, SO_RCVBUF, &options.receive_buffer, sizeof options.receive_buffer);
    }
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (::connect(socket_.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
      throw std::runtime_error("connect");
    }
    if (options.tls) handshake();
  }

  /// False when the other side has closed.
  bool send(std::string_view bytes) {
    while (!bytes.empty()) {
      const long sent = tls_ ? ::SSL_write(tls_.get(), bytes.data(), static_cast<int>(bytes.size()))
                             : ::send(socket_.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL);
      if (sent <= 0) return false;
      bytes.remove_prefix(static_cast<std::size_t>(sent));
    }
    return true;
  }

  /// Appends what comes next. False at the end of the connection, and after `timeout`.
  bool receive_some(std::string& into, std::chrono::milliseconds timeout = kPatience) {
    if (!tls_ || ::SSL_pending(tls_.get()) == 0) {
      pollfd readable{.fd = socket_.get(), .events = POLLIN, .revents = 0};
      if (::poll(&readable, 1, static_cast<int>(timeout.count())) <= 0) return false;
    }
    char buffer[65536];
    const long got =
        tls_ ? ::SSL_read(tls_.get(), buffer, sizeof buffer) : ::recv(socket_.get(), buffer, sizeof buffer, 0);
    if (got <= 0) return false;
    into.append(buffer, static_cast<std::size_t>(got));
    return true;
  }

  /// All until the other side closes.
  std::string receive_rest() {
    std::string all;
    while (receive_some(all)) {
    }
    return all;
  }

  /// Whether the other side ends the connection.
  bool ends(std::chrono::milliseconds timeout = kPatience) {
    const auto deadline = std::chrono::steady_clock::now() + timeout;
    std::string ignored;
    for (;;) {
      const auto left =
          std::chrono::duration_cast<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now());
      if (left <= 0ms) return false;
      pollfd readable{.fd = socket_.get(), .events = POLLIN, .revents = 0};
      if (::poll(&readable, 1, static_cast<int>(left.count())) <= 0) return false;
      if (!receive_some(ignored)) return true;
    }
  }

  void end_sending() { ::shutdown(socket_.get(), SHUT_WR); }

 private:
  void handshake() {
    context_.reset(::SSL_CTX_new(::TLS_client_method()));
    tls_.reset(::SSL_new(context_.get()));
    ::SSL_set_fd(tls_.get(), socket_.get());
    if (::SSL_connect(tls_.get()) != 1) throw std::runtime_error("no TLS there");
  }

  struct Free {
    void operator()(SSL_CTX* context) const { ::SSL_CTX_free(context); }
    void operator()(SSL* tls) const { ::SSL_free(tls); }
  };
  bus::FileDescriptor socket_;
  std::unique_ptr<SSL_CTX, Free> context_;
  std::unique_ptr<SSL, Free> tls_;
};

struct HttpAnswer {
  int status = 0;  ///< 0: none came
  std::string head, body;

  /// Of a field, empty when there is none.
  [[nodiscard]] std::string field(const std::string& name) const {
    const std::size_t at = head.find("\r\n" + name + ": ");
    if (at == std::string::npos) return {};
    const std::size_t begin = at + name.size() + 4;
    return head.substr(begin, head.find("\r\n", begin) - begin);
  }
};

inline HttpAnswer parse_answer(const std::string& text) {
  HttpAnswer answer;
  const std::size_t end = text.find("\r\n\r\n");
  if (!text.starts_with("HTTP/1.1 ") || end == std::string::npos) return answer;
  answer.status = std::stoi(text.substr(9, 3));
  answer.head = text.substr(0, end + 2);
  answer.body = text.substr(end + 4);
  return answer;
}

/// Sends a request and reads until the other side closes.
inline HttpAnswer ask(std::uint16_t port, const std::string& request, WireClient::Options options = {}) {
  WireClient client(port, options);
  client.send(request);
  return parse_answer(client.receive_rest());
}

inline HttpAnswer get(std::uint16_t port, const std::string& target, const std::string& fields = "",
                      WireClient::Options options = {}) {
  return ask(port,
             "GET " + target + " HTTP/1.1\r\nHost: localhost:" + std::to_string(port) + "\r\n" + fields +
                 "Connection: close\r\n\r\n",
             options);
}

/// The browser's end of a WebSocket, as RFC 6455 has it.
class WebSocketClient {
 public:
  struct Options {
    std::string fields = "Sec-WebSocket-Protocol: splatbus.stream.1\r\n";
    std::string target = "/stream";
    std::string host = "localhost";
    WireClient::Options wire;
  };
  explicit WebSocketClient(std::uint16_t port) : WebSocketClient(port, Options()) {}
  WebSocketClient(std::uint16_t port, const Options& options) : wire_(port, options.wire) {
    wire_.send("GET " + options.target + " HTTP/1.1\r\nHost: " + options.host + "\r\n" +
               "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
               "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n" +
               options.fields + "\r\n");
    while (received_.find("\r\n\r\n") == std::string::npos && wire_.receive_some(received_)) {
    }
    answer_ = parse_answer(received_);
    if (answer_.status == 101) {
      received_ = answer_.body;
    } else {
      answer_.body += wire_.receive_rest();
    }
  }

  [[nodiscard]] const HttpAnswer& answer() const { return answer_; }
  [[nodiscard]] bool open() const { return answer_.status == 101; }
  [[nodiscard]] WireClient& wire() { return wire_; }

  static constexpr std::uint8_t kContinuation = 0, kText = 1, kBinary = 2, kClose = 8, kPing = 9, kPong = 10;

  bool send_frame(std::uint8_t opcode, std::string_view payload, bool last = true) {
    std::string frame(1, static_cast<char>((last ? 0x80 : 0) | opcode));
    const std::size_t bytes = payload.size();
    const int width = bytes < 126 ? 0 : bytes < 65536 ? 2 : 8;
    frame += static_cast<char>(0x80 | (width == 0 ? bytes : width == 2 ? 126 : 127));
    for (int i = width - 1; i >= 0; --i) frame += static_cast<char>(bytes >> (8 * i));
    const char mask[4] = {0x12, 0x34, 0x56, 0x78};
    frame.append(mask, 4);
    for (std::size_t i = 0; i < bytes; ++i) frame += static_cast<char>(payload[i] ^ mask[i % 4]);
    return wire_.send(frame);
  }
  /// One message of the subprotocol.
  bool send_packet(std::span<const std::uint8_t> packet, std::span<const std::uint8_t> payload = {}) {
    std::string message;
    for (int i = 0; i < 4; ++i) message += static_cast<char>(packet.size() >> (8 * i));
    message.append(packet.begin(), packet.end());
    message.append(payload.begin(), payload.end());
    return send_frame(kBinary, message);
  }

  /// The next binary message; pings and closes are answered. Nullopt at the end, when close_code() says why, and after
  /// `timeout`.
  std::optional<std::string> receive(std::chrono::milliseconds timeout = kPatience) {
    const auto deadline = std::chrono::steady_clock::now() + timeout;
    for (;;) {
      while (auto frame = take_frame()) {
        if (frame->first == kBinary) return std::move(frame->second);
        if (frame->first == kPing) send_frame(kPong, frame->second);
        if (frame->first == kClose && frame->second.size() >= 2) {
          close_code_ = static_cast<std::uint8_t>(frame->second[0]) * 256 + static_cast<std::uint8_t>(frame->second[1]);
          send_frame(kClose, frame->second);
        }
      }
      const auto left =
          std::chrono::duration_cast<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now());
      if (left <= 0ms || !wire_.receive_some(received_, left)) return std::nullopt;
    }
  }
  [[nodiscard]] int close_code() const { return close_code_; }

 private:
  std::optional<std::pair<std::uint8_t, std::string>> take_frame() {
    if (received_.size() < 2) return std::nullopt;
    const auto byte = [&](std::size_t i) { return static_cast<std::uint8_t>(received_[i]); };
    std::size_t bytes = byte(1) & 0x7FU, head = 2;
    const std::size_t width = bytes == 126 ? 2 : bytes == 127 ? 8 : 0;
    if (received_.size() < head + width) return std::nullopt;
    if (width > 0) bytes = 0;
    for (std::size_t i = 0; i < width; ++i) bytes = bytes << 8U | byte(head + i);
    head += width;
    if (received_.size() < head + bytes) return std::nullopt;
    std::pair<std::uint8_t, std::string> frame(byte(0) & 0xFU, received_.substr(head, bytes));
    received_.erase(0, head + bytes);
    return frame;
  }

  WireClient wire_;
  std::string received_;
  HttpAnswer answer_;
  int close_code_ = 0;
};

}  // namespace splatbus::gateway_test
