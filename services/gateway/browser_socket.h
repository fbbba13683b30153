#pragma once

// Part of server.cpp: of Boost.Beast, which is slow to compile.

#include <spdlog/spdlog.h>

#include <algorithm>
#include <exception>
#include <limits>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <utility>
#include <vector>
#include <zmq.hpp>

#include "bus/clock.h"
#include "bus/log_sink.h"
#include "gateway/boost_types.h"
#include "gateway/inbound.h"
#include "gateway/site.h"
#include "gateway/sockets.h"
#include "gateway/streamers.h"

namespace splatbus::gateway {

/// A browser with a WebSocket, as the others see it.
class Browser {
 public:
  virtual ~Browser() = default;
  /// Ends it without another word.
  virtual void stop() = 0;
  /// Tells it why, and ends it.
  virtual void close(const char* why) = 0;
  [[nodiscard]] virtual int socket() = 0;
  /// To another streamer. What it shows stays until it has that one's. When it throws all is as before.
  virtual void move(const stream::StreamerPlace& /*place*/) {}

  bus::Rights rights;
  std::string token;
  std::optional<stream::StreamerPlace> streamer;  ///< nullopt: it follows none
  std::int64_t write_began_ns = 0;                ///< 0: nothing is being written
  std::int64_t progress_ns = 0;                   ///< when its kernel last took bytes of that
  std::uint64_t acknowledged = 0;
};

/// What all browsers share. Outlives them.
class Relay {
 public:
  Relay(const Limits& bounds, Traffic& counts, Streamers& all_streamers)
      : limits(bounds), traffic(counts), streamers(all_streamers), inbound(bounds) {}

  void begin_write(Browser& browser, std::size_t bytes) {
    browser.write_began_ns = browser.progress_ns = bus::now_ns();
    traffic.queued_bytes += bytes;
    if (traffic.queued_bytes > limits.queued_bytes) stall(slowest());
  }
  void end_write(Browser& browser, std::size_t bytes) {
    browser.write_began_ns = 0;
    traffic.queued_bytes -= bytes;
  }
  /// Ends those that take nothing.
  void check(std::int64_t now_ns) {
    for (Browser* browser : std::vector<Browser*>(browsers.begin(), browsers.end())) {
      if (browser->write_began_ns == 0) continue;
      const std::uint64_t acknowledged = acknowledged_bytes(browser->socket());
      if (acknowledged != browser->acknowledged) browser->progress_ns = now_ns;
      browser->acknowledged = acknowledged;
      if (static_cast<double>(now_ns - browser->progress_ns) > limits.stall_s * 1e9) stall(*browser);
    }
  }

  /// Moves those whose streamer is gone, or about to go; and now and then one to where far fewer are.
  void share(std::int64_t now_ns) {
    const bool balances = now_ns >= next_balance_ns_;
    if (balances) next_balance_ns_ = now_ns + kBalanceNs;
    bool balanced = !balances;
    int moves = 0;
    for (Browser* browser : browsers) {
      if (moves == kMovesACall) break;
      if (!browser->streamer) continue;
      std::optional<stream::StreamerPlace> place = streamers.instead_of(*browser->streamer, now_ns);
      if (!place && !balanced) balanced = (place = streamers.better_than(*browser->streamer, now_ns)).has_value();
      if (!place) continue;
      const bool is_there = place->endpoint == browser->streamer->endpoint;  // before the bus had named it
      try {
        if (!is_there) browser->move(*place);
      } catch (const std::exception& error) {
        streamers.pass_over(*place, error.what(), now_ns);
        continue;
      }
      browser->streamer = *place;
      if (is_there) continue;
      ++moves;
      ++traffic.moves;
    }
  }

  const Limits& limits;
  Traffic& traffic;
  Streamers& streamers;
  InboundTotal inbound;
  zmq::context_t context;
  std::set<Browser*> browsers;

 private:
  static constexpr std::int64_t kBalanceNs = 500'000'000;
  static constexpr int kMovesACall = 64;  // for a moment each has two connections
  Browser& slowest() {
    return **std::min_element(browsers.begin(), browsers.end(), [](const Browser* a, const Browser* b) {
      const auto began = [](const Browser* browser) {
        return browser->write_began_ns == 0 ? std::numeric_limits<std::int64_t>::max() : browser->write_began_ns;
      };
      return began(a) < began(b);
    });
  }
  void stall(Browser& browser) {
    traffic.refuse(Refusal::Stalled);
    // It would not read a word about that either.
    if (log_limiter_.allow()) spdlog::warn("a browser that does not read is closed");
    browser.write_began_ns = 0;
    browser.stop();
  }
  bus::LogLimiter log_limiter_;
  std::int64_t next_balance_ns_ = 0;
};

/// A browser's WebSocket, whatever is said on it: how it is accepted, held to its bounds, and ended. Held by its
/// coroutines.
class BrowserSocket : public Browser, public std::enable_shared_from_this<BrowserSocket> {
 public:
  BrowserSocket(Connection connection, Relay& relay, Site::Admission admission)
      : relay_(relay),
        socket_(std::move(connection)),
        subprotocol_(admission.subprotocol),
        inbound_(relay.limits, relay.inbound) {
    rights = *admission.rights;
    token = std::move(admission.token);
    relay_.browsers.insert(this);
  }
  ~BrowserSocket() override { relay_.browsers.erase(this); }

  /// Until either side ends.
  template <class Request>
  asio::awaitable<void> run(Request request) {
    const auto self = shared_from_this();
    beast::get_lowest_layer(socket_).expires_never();
    socket_.set_option(websocket::stream_base::timeout{.handshake_timeout = seconds(relay_.limits.handshake_s),
                                                       .idle_timeout = seconds(relay_.limits.idle_s),
                                                       .keep_alive_pings = true});
    socket_.set_option(websocket::stream_base::decorator([this](websocket::response_type& response) {
      for (const auto& [name, value] : common_fields()) response.set(name, value);
      response.set(http::field::sec_websocket_protocol, subprotocol_);
    }));
    socket_.read_message_max(relay_.limits.message_bytes);
    socket_.auto_fragment(false);
    socket_.binary(true);
    // Pings never come out of a read, so they are counted here.
    socket_.control_callback([this](websocket::frame_type, beast::string_view) {
      if (!inbound_.take_control(bus::now_ns())) flood();
    });
    const auto [error] = co_await socket_.async_accept(request, kNoThrow);
    if (error) co_return;
    bound_unsent_bytes(socket());
    opened();
    asio::co_spawn(socket_.get_executor(), write_messages(self), asio::detached);
    co_await read_messages();
    stop();
  }

  void stop() override {
    stopped_ = true;
    beast::get_lowest_layer(socket_).close();
    wake_writer();
  }
  void close(const char* why) override {
    if (std::exchange(closing_, true)) return;
    wake_writer();
    asio::co_spawn(socket_.get_executor(), close(shared_from_this(), why), asio::detached);
  }
  [[nodiscard]] int socket() override { return beast::get_lowest_layer(socket_).socket().native_handle(); }

 protected:
  /// Called once, before the two below.
  virtual void opened() {}
  /// Writes what there is to be said, until it is stopped or closing, or a write fails.
  virtual asio::awaitable<void> write_messages() = 0;
  /// Has write_messages() look again.
  virtual void wake_writer() = 0;
  /// Of what the browser has said. Empty, or why it is turned away.
  virtual std::string take(std::span<const std::uint8_t> message, bool binary) = 0;

  /// Writes one message within the bounds that all browsers share; false when the connection is of no use any more.
  template <class Buffers>
  asio::awaitable<bool> write(const Buffers& message) {
    const std::size_t bytes = asio::buffer_size(message);
    relay_.begin_write(*this, bytes);
    const auto [error, written] = co_await socket_.async_write(message, kNoThrow);
    relay_.end_write(*this, bytes);
    if (error) co_return false;
    ++relay_.traffic.messages_to;
    relay_.traffic.bytes_to += bytes;
    co_return true;
  }

  Relay& relay_;
  websocket::stream<Connection> socket_;
  bool stopped_ = false, closing_ = false;

 private:
  static asio::awaitable<void> write_messages(std::shared_ptr<BrowserSocket> self) {
    co_await self->write_messages();
    if (!self->closing_) self->stop();
  }
  static asio::awaitable<void> close(std::shared_ptr<BrowserSocket> self, std::string why) {
    const websocket::close_reason reason(websocket::close_code::policy_error, why);
    co_await self->socket_.async_close(reason, kNoThrow);
    self->stop();
  }

  asio::awaitable<void> read_messages() {
    beast::flat_buffer buffer(relay_.limits.message_bytes);
    while (!stopped_) {
      const auto [error, bytes] = co_await socket_.async_read(buffer, kNoThrow);
      if (error == websocket::error::message_too_big || error == websocket::error::buffer_overflow) {
        relay_.traffic.refuse(Refusal::Malformed);
      }
      if (error || stopped_) co_return;
      ++relay_.traffic.messages_from;
      relay_.traffic.bytes_from += bytes;
      co_await wait_for_turn(bytes);
      if (!closing_) {
        const std::string problem =
            take({static_cast<const std::uint8_t*>(buffer.data().data()), bytes}, socket_.got_binary());
        if (!problem.empty()) {
          relay_.traffic.refuse(Refusal::Malformed);
          closing_ = true;
          const websocket::close_reason reason(websocket::close_code::policy_error, problem);
          co_await socket_.async_close(reason, kNoThrow);
          co_return;
        }
      }
      buffer.consume(bytes);
    }
  }

  asio::awaitable<void> wait_for_turn(std::size_t bytes) {
    asio::steady_timer timer(socket_.get_executor());
    while (!stopped_ && !inbound_.take(bytes, bus::now_ns())) {
      timer.expires_after(std::chrono::milliseconds(10));
      co_await timer.async_wait(kNoThrow);
    }
  }

  void flood() {
    relay_.traffic.refuse(Refusal::Flood);
    stop();
  }

  const std::string subprotocol_;
  Inbound inbound_;
};

}  // namespace splatbus::gateway
