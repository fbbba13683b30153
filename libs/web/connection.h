#pragma once

// Includes Boost.Beast, which is slow to compile: for few sources, not for their headers.

#include <array>
#include <boost/asio/any_completion_handler.hpp>
#include <boost/asio/any_io_executor.hpp>
#include <boost/asio/async_result.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/ssl/stream.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/core/flat_stream.hpp>
#include <boost/beast/websocket.hpp>
#include <boost/beast/websocket/ssl.hpp>
#include <cstddef>
#include <utility>
#include <variant>

namespace splatbus::web {

namespace asio = boost::asio;
namespace beast = boost::beast;
/// Reads no faster than its owner says.
using Tcp = beast::basic_stream<asio::ip::tcp, asio::any_io_executor, beast::simple_rate_policy>;
/// Small buffers leave together. Beast's own ssl_stream is the same, but that Clang 16 finds the end of a WebSocket
/// over Boost 1.81's ambiguous.
using Tls = beast::flat_stream<asio::ssl::stream<Tcp>>;

/// The first ones of some buffers. A read or a write may take fewer than it was given.
template <class Buffer>
class FirstBuffers {
 public:
  using value_type = Buffer;
  using const_iterator = const Buffer*;

  template <class Sequence>
  explicit FirstBuffers(const Sequence& all) {
    for (auto next = asio::buffer_sequence_begin(all); next != asio::buffer_sequence_end(all); ++next) {
      if (count_ == buffers_.size()) break;
      const Buffer buffer(*next);
      if (buffer.size() > 0) buffers_.at(count_++) = buffer;
    }
  }
  [[nodiscard]] const_iterator begin() const { return buffers_.data(); }
  [[nodiscard]] const_iterator end() const { return buffers_.data() + count_; }

 private:
  std::array<Buffer, 16> buffers_;
  std::size_t count_ = 0;
};

/// A connection with TLS or without: an AsyncStream as Asio has it, for one thread at a time. One type for both, which
/// knows its callers by erased handlers: what is above it is compiled once, not for either, and what is below it once,
/// not for every caller. No operation can be cancelled by itself, and none may be under way when it is moved.
class Connection {
 public:
  using executor_type = Tcp::executor_type;
  using next_layer_type = Tcp;
  using TransferHandler = asio::any_completion_handler<void(beast::error_code, std::size_t)>;
  using EndHandler = asio::any_completion_handler<void(beast::error_code)>;

  explicit Connection(Tcp tcp) : stream_(std::move(tcp)) {}
  explicit Connection(Tls tls) : stream_(std::move(tls)) {}

  /// nullptr without TLS.
  [[nodiscard]] Tls* tls() { return std::get_if<Tls>(&stream_); }
  [[nodiscard]] Tcp& next_layer() {
    return tls() != nullptr ? tls()->next_layer().next_layer() : std::get<Tcp>(stream_);
  }
  [[nodiscard]] const Tcp& next_layer() const {
    const Tls* const secured = std::get_if<Tls>(&stream_);
    return secured != nullptr ? secured->next_layer().next_layer() : std::get<Tcp>(stream_);
  }
  [[nodiscard]] executor_type get_executor() { return next_layer().get_executor(); }

  template <class Buffers, class Token>
  auto async_read_some(const Buffers& buffers, Token&& token) {
    return asio::async_initiate<Token, void(beast::error_code, std::size_t)>(
        [this](auto handler, const Buffers& all) {
          read_some(FirstBuffers<asio::mutable_buffer>(all), TransferHandler(std::move(handler)));
        },
        token, buffers);
  }
  template <class Buffers, class Token>
  auto async_write_some(const Buffers& buffers, Token&& token) {
    return asio::async_initiate<Token, void(beast::error_code, std::size_t)>(
        [this](auto handler, const Buffers& all) {
          write_some(FirstBuffers<asio::const_buffer>(all), TransferHandler(std::move(handler)));
        },
        token, buffers);
  }
  void tear_down(beast::role_type role, EndHandler handler) {
    const auto end = [&](auto& stream) {
      using beast::websocket::async_teardown;
      async_teardown(role, stream, Posted<EndHandler>{std::move(handler), get_executor()});
    };
    if (tls() != nullptr) {
      end(tls()->next_layer());
    } else {
      end(std::get<Tcp>(stream_));
    }
  }

 private:
  /// Beast posts to a handler's executor, which that of an erased handler is not for.
  template <class Handler>
  struct Posted {
    using executor_type = Connection::executor_type;
    Handler handler;
    executor_type executor;
    [[nodiscard]] executor_type get_executor() const noexcept { return executor; }
    template <class... Arguments>
    void operator()(Arguments... arguments) {
      std::move(handler)(arguments...);
    }
  };

  void read_some(const FirstBuffers<asio::mutable_buffer>& buffers, TransferHandler handler) {
    std::visit(
        [&](auto& stream) {
          stream.async_read_some(buffers, Posted<TransferHandler>{std::move(handler), get_executor()});
        },
        stream_);
  }
  void write_some(const FirstBuffers<asio::const_buffer>& buffers, TransferHandler handler) {
    std::visit(
        [&](auto& stream) {
          stream.async_write_some(buffers, Posted<TransferHandler>{std::move(handler), get_executor()});
        },
        stream_);
  }

  std::variant<Tcp, Tls> stream_;
};

/// What Beast's WebSocket ends a stream by.
template <class Handler>
void async_teardown(beast::role_type role, Connection& connection, Handler&& handler) {
  connection.tear_down(role, Connection::EndHandler(std::forward<Handler>(handler)));
}

}  // namespace splatbus::web
