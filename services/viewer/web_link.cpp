#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <boost/asio/as_tuple.hpp>
#include <boost/asio/awaitable.hpp>
#include <boost/asio/co_spawn.hpp>
#include <boost/asio/detached.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/posix/stream_descriptor.hpp>
#include <boost/asio/ssl/context.hpp>
#include <boost/asio/ssl/host_name_verification.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/asio/use_awaitable.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/websocket.hpp>
#include <cstdlib>
#include <deque>
#include <exception>
#include <optional>
#include <random>
#include <utility>

#include "bus/error.h"
#include "stream/layout.h"
#include "stream/web_message.h"
#include "viewer/packet_link.h"
#include "viewer/round_trip.h"
#include "viewer/web_address.h"
#include "web/connection.h"

namespace splatbus::viewer {

namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
namespace websocket = beast::websocket;
using asio::awaitable;
using WebSocket = websocket::stream<web::Connection>;
constexpr auto kNoThrow = asio::as_tuple(asio::use_awaitable);

constexpr std::chrono::seconds kConnect(5), kIdleTime(10);
constexpr std::chrono::milliseconds kFarewell(200);
constexpr std::size_t kMaxMessages = 64, kMaxBytes = std::size_t{16} << 20;  // that wait to be taken
constexpr std::size_t kMaxUnsent = 64;

// GCC 12 destroys twice what is made in an expression with co_await: there, everything has a name.

class WebLink final : public PacketLink {
 public:
  explicit WebLink(const WebLinkOptions& options)
      : options_(options), address_(parse_web_address(options.url)), tls_(asio::ssl::context::tls_client) {
    const char* variable = std::getenv("SPLATBUS_TOKEN");
    token_ = !options.token.empty()    ? options.token
             : !address_.token.empty() ? address_.token
             : variable != nullptr     ? variable
                                       : "";
    // What no field of a request may hold.
    if (token_.find_first_of(" \t\r\n") != std::string::npos) throw bus::Error("the token has blanks in it");
    tls_.set_verify_mode(asio::ssl::verify_peer);
    beast::error_code error;
    if (options_.ca.empty()) {
      tls_.set_default_verify_paths(error);
    } else {
      tls_.load_verify_file(options_.ca, error);
    }
    if (error) throw bus::Error(fmt::format("ca {}: {}", options_.ca, error.message()));
    asio::co_spawn(io_, keep_connected(), [](const std::exception_ptr& thrown) {
      if (thrown) std::rethrow_exception(thrown);
    });
  }

  ~WebLink() override {
    ending_ = true;
    const auto end = std::chrono::steady_clock::now() + kFarewell;
    while (open_ && !unsent_.empty() && std::chrono::steady_clock::now() < end) io_.run_one_until(end);
    io_.stop();
  }

  void wait(std::chrono::milliseconds timeout, int wake) override {
    watch(wake);
    const auto end = std::chrono::steady_clock::now() + timeout;
    io_.poll();
    while (messages_.empty() && !woken_ && !opened_ && std::chrono::steady_clock::now() < end) io_.run_one_until(end);
    woken_ = false;
  }

  std::optional<Message> receive() override {
    if (messages_.empty()) return std::nullopt;
    taken_ = std::move(messages_.front());
    messages_.pop_front();
    bytes_ -= taken_.size();
    room_.cancel();
    try {
      const auto message = stream::take_apart({reinterpret_cast<const std::uint8_t*>(taken_.data()), taken_.size()});
      return Message{.packet = message.packet, .payload = message.payload};
    } catch (const stream::StreamError&) {
      return Message{};  // refused for what it is
    }
  }

  void send(std::span<const std::uint8_t> packet) override {
    if (!open_ || unsent_.size() >= kMaxUnsent) return;
    const auto header = stream::web_header(packet.size());
    std::string message(header.begin(), header.end());
    message.append(packet.begin(), packet.end());
    unsent_.push_back(std::move(message));
    news_.cancel();
  }

  std::optional<double> round_trip_ms() const override { return open_ ? tcp_round_trip_ms(descriptor_) : std::nullopt; }
  bool take_opened() override { return std::exchange(opened_, false); }
  std::optional<std::string> take_notice() override { return std::exchange(notice_, std::nullopt); }

 private:
  /// The same again is no news.
  void say(const std::string& text) {
    if (said_ != text) notice_ = said_ = text;
  }

  void watch(int wake) {
    if (wake < 0 || watching_) return;
    if (watched_ != wake) {
      beast::error_code ignored;
      wake_.close(ignored);
      wake_.assign(::dup(wake), ignored);
      watched_ = wake;
    }
    watching_ = true;
    wake_.async_wait(asio::posix::stream_descriptor::wait_read, [this](const beast::error_code& error) {
      watching_ = false;
      woken_ = woken_ || !error;
    });
  }

  awaitable<void> keep_connected() {
    auto pause = options_.first_pause;
    std::minstd_rand random(std::random_device{}());
    while (!ending_) {
      heard_ = false;
      co_await live();
      open_ = false;
      unsent_.clear();
      pause = heard_ ? options_.first_pause : std::min(2 * pause, options_.longest_pause);
      // Not all of them at once, when a gateway comes back.
      std::uniform_real_distribution<double> share(0.5, 1);
      asio::steady_timer timer(io_, std::chrono::duration_cast<std::chrono::milliseconds>(pause * share(random)));
      co_await timer.async_wait(kNoThrow);
    }
  }

  /// One connection, from its beginning to its end.
  awaitable<void> live() {
    std::optional<web::Connection> connection;
    std::string problem = co_await connect(connection);
    std::optional<WebSocket> greeted;
    if (connection) {
      greeted.emplace(std::move(*connection));
      problem = co_await greet(*greeted);
    }
    if (!problem.empty()) {
      say(fmt::format("{}: {}", address_.authority(), problem));
      co_return;
    }
    WebSocket& socket = *greeted;
    said_.clear();
    descriptor_ = beast::get_lowest_layer(socket).socket().native_handle();
    open_ = opened_ = true;
    reading_ = true;
    asio::co_spawn(io_, read(socket), asio::detached);
    while (reading_) {
      if (unsent_.empty()) {
        news_.expires_at(asio::steady_timer::time_point::max());
        co_await news_.async_wait(kNoThrow);
        continue;
      }
      const auto buffer = asio::buffer(unsent_.front());
      const auto [error, written] = co_await socket.async_write(buffer, kNoThrow);
      if (!unsent_.empty()) unsent_.pop_front();
      if (error) beast::get_lowest_layer(socket).close();
      if (error) break;
    }
    while (reading_) {  // it uses the socket
      news_.expires_at(asio::steady_timer::time_point::max());
      co_await news_.async_wait(kNoThrow);
    }
  }

  /// Makes `connection`, or says what went wrong.
  awaitable<std::string> connect(std::optional<web::Connection>& connection) {
    asio::ip::tcp::resolver resolver(io_);
    const auto [unknown, endpoints] = co_await resolver.async_resolve(address_.host, address_.port, kNoThrow);
    if (unknown) co_return unknown.message();
    web::Tcp tcp(io_);
    tcp.expires_after(kConnect);
    const auto [unreached, endpoint] = co_await tcp.async_connect(endpoints, kNoThrow);
    if (unreached) co_return unreached.message();
    beast::error_code ignored;
    tcp.socket().set_option(asio::ip::tcp::no_delay(true), ignored);
    if (!address_.tls) {
      connection.emplace(std::move(tcp));
      co_return std::string();
    }
    web::Tls tls(std::move(tcp), tls_);
    tls.next_layer().set_verify_callback(asio::ssl::host_name_verification(address_.host));
    const bool named = !is_address(address_.host);
    if (named) SSL_set_tlsext_host_name(tls.next_layer().native_handle(), address_.host.c_str());
    const auto [distrusted] = co_await tls.next_layer().async_handshake(asio::ssl::stream_base::client, kNoThrow);
    if (distrusted) co_return fmt::format("no TLS that can be trusted: {}", distrusted.message());
    connection.emplace(std::move(tls));
    co_return std::string();
  }

  /// Empty, or what went wrong.
  awaitable<std::string> greet(WebSocket& socket) {
    beast::get_lowest_layer(socket).expires_never();
    socket.set_option(websocket::stream_base::timeout{
        .handshake_timeout = kConnect, .idle_timeout = kIdleTime, .keep_alive_pings = true});
    socket.set_option(websocket::stream_base::decorator([this](websocket::request_type& request) {
      request.set(http::field::sec_websocket_protocol, stream::kWebSubprotocol);
      if (!token_.empty()) request.set(http::field::authorization, "Bearer " + token_);
    }));
    socket.read_message_max(stream::kWebHeaderBytes + stream::kMaxPacketBytes + stream::kMaxPayloadBytes);
    socket.auto_fragment(false);
    socket.binary(true);
    websocket::response_type response;
    const std::string host = address_.authority();
    const auto [refused] = co_await socket.async_handshake(response, host, address_.target, kNoThrow);
    if (refused && response.result_int() >= 400) {
      co_return fmt::format("refused with {} {}", response.result_int(), std::string(response.reason()));
    }
    if (refused) co_return refused.message();
    if (response[http::field::sec_websocket_protocol] != stream::kWebSubprotocol) co_return "not a splatbus stream";
    co_return std::string();
  }

  awaitable<void> read(WebSocket& socket) {
    for (;;) {
      beast::flat_buffer buffer;
      const auto [error, bytes] = co_await socket.async_read(buffer, kNoThrow);
      if (error) {
        const auto& reason = socket.reason();
        say(fmt::format("{}: {}", address_.authority(),
                        reason.code == websocket::close_code::none
                            ? error.message()
                            : fmt::format("closed with {} {}", reason.code, std::string(reason.reason.c_str()))));
        break;
      }
      heard_ = true;
      const auto data = buffer.data();
      messages_.emplace_back(static_cast<const char*>(data.data()), data.size());
      bytes_ += bytes;
      // The gateway waits, and the streamer, when the viewer does.
      while (messages_.size() >= kMaxMessages || bytes_ > kMaxBytes) {
        room_.expires_at(asio::steady_timer::time_point::max());
        co_await room_.async_wait(kNoThrow);
      }
    }
    beast::get_lowest_layer(socket).close();
    reading_ = false;
    news_.cancel();
  }

  static bool is_address(const std::string& host) {
    beast::error_code error;
    (void)asio::ip::make_address(host, error);
    return !error;
  }

  const WebLinkOptions options_;
  const WebAddress address_;
  std::string token_;
  asio::ssl::context tls_;
  bool open_ = false, opened_ = false, reading_ = false, heard_ = false, ending_ = false;
  bool woken_ = false, watching_ = false;
  int watched_ = -1, descriptor_ = -1;
  std::optional<std::string> notice_;
  std::string said_, taken_;
  std::deque<std::string> messages_, unsent_;
  std::size_t bytes_ = 0;  ///< of messages_
  asio::io_context io_{1};
  asio::steady_timer news_{io_}, room_{io_};
  asio::posix::stream_descriptor wake_{io_};
};

}  // namespace

std::unique_ptr<PacketLink> make_web_link(const WebLinkOptions& options) {
  return std::make_unique<WebLink>(options);
}

}  // namespace splatbus::viewer
