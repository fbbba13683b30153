#include "gateway/server.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <array>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ssl/context.hpp>
#include <boost/asio/write.hpp>
#include <exception>
#include <limits>
#include <optional>
#include <vector>

#include "bus/error.h"
#include "bus/log_sink.h"
#include "gateway/connections.h"
#include "gateway/stream_session.h"

namespace splatbus::gateway {

namespace {

using asio::awaitable;
using asio::ip::tcp;
using HttpRequest = http::request<http::string_body>;

constexpr std::size_t kMaxHeaderBytes = 8192, kMaxTargetBytes = 2048;
constexpr int kRequestsAConnection = 1000;
constexpr std::size_t kSliceBytes = 256 << 10;
constexpr double kSliceS = 20;  ///< in which a client takes one
constexpr std::size_t kDescriptorsAConnection = 4, kDescriptorsReserved = 64;
constexpr std::chrono::milliseconds kTick(100);

/// What counts as one address for the limits.
std::string key_of(const asio::ip::address& address) {
  if (address.is_v4()) return address.to_string();
  const auto v6 = address.to_v6();
  if (v6.is_v4_mapped()) return asio::ip::make_address_v4(asio::ip::v4_mapped, v6).to_string();
  const auto bytes = v6.to_bytes();
  return {bytes.begin(), bytes.begin() + 8};
}

Request view_of(const HttpRequest& request) {
  const auto field = [&](http::field name) -> std::optional<std::string_view> {
    const auto found = request.find(name);
    if (found == request.end()) return std::nullopt;
    return std::string_view(found->value().data(), found->value().size());
  };
  const auto view = [](beast::string_view text) { return std::string_view(text.data(), text.size()); };
  return {.method = view(request.method_string()),
          .target = view(request.target()),
          .host = field(http::field::host).value_or(""),
          .body = request.body(),
          .origin = field(http::field::origin),
          .authorization = field(http::field::authorization),
          .if_none_match = field(http::field::if_none_match),
          .content_type = field(http::field::content_type),
          .protocols = field(http::field::sec_websocket_protocol)};
}

/// Of what two parsers could understand in two ways, nothing is served.
bool is_plain(const HttpRequest& request) {
  return request.count(http::field::transfer_encoding) == 0 && request.count(http::field::content_length) <= 1 &&
         request.count(http::field::host) == 1 && request.count(http::field::origin) <= 1 &&
         request.target().starts_with('/') && request.target().size() <= kMaxTargetBytes &&
         (request.body().empty() || request.method() == http::verb::post);
}

Response plain(int status, const char* text) {
  return {.status = status, .fields = {}, .body = std::make_shared<const std::string>(text)};
}

// GCC 12 destroys twice what is made in an expression with co_await: there, everything has a name.

/// Sends it; false when the connection is of no use any more.
template <class Stream>
awaitable<bool> respond(Stream& stream, const Response& response, bool head, bool keep) {
  http::response<http::empty_body> message(static_cast<http::status>(response.status), 11);
  for (const auto& [name, value] : common_fields()) message.set(name, value);
  for (const auto& [name, value] : response.fields) message.set(name, value);
  const std::size_t bytes = response.body ? response.body->size() : 0;
  if (response.body) message.set(http::field::content_type, response.type);
  if (response.status != 204 && response.status != 304) message.content_length(bytes);
  message.keep_alive(keep);
  http::response_serializer<http::empty_body> serializer(message);
  auto& lowest = beast::get_lowest_layer(stream);
  lowest.expires_after(seconds(kSliceS));
  if (const auto [error, sent] = co_await http::async_write_header(stream, serializer, kNoThrow); error)
    co_return false;
  for (std::size_t at = 0; !head && at < bytes; at += kSliceBytes) {
    lowest.expires_after(seconds(kSliceS));
    const auto slice = asio::buffer(response.body->data() + at, std::min(kSliceBytes, bytes - at));
    if (const auto [error, sent] = co_await asio::async_write(stream, slice, kNoThrow); error) co_return false;
  }
  co_return keep;
}

/// Ends a connection so that its last response arrives even where something of the request was left unread.
template <class Stream>
awaitable<void> finish(Stream& stream) {
  auto& lowest = beast::get_lowest_layer(stream);
  lowest.expires_after(std::chrono::seconds(1));
  if constexpr (!std::is_same_v<Stream, Tcp>) co_await stream.async_shutdown(kNoThrow);
  beast::error_code ignored;
  lowest.socket().shutdown(tcp::socket::shutdown_send, ignored);
  std::array<char, 4096> rest;
  for (int i = 0; i < 64; ++i) {
    const auto [error, bytes] = co_await lowest.async_read_some(asio::buffer(rest), kNoThrow);
    if (error) co_return;
  }
}

}  // namespace

struct Server::Impl {
  Impl(const Options& all, std::string streamer, Site& pages, Traffic& counts)
      : options(all),
        site(pages),
        traffic(counts),
        relay(all.limits, counts, std::move(streamer)),
        connections(most_connections(), static_cast<std::size_t>(all.limits.connections_per_address), counts) {
    relay.context.set(zmq::ctxopt::max_sockets, static_cast<int>(most_connections()) + 8);
    if (!options.certificate.empty()) load_certificate();
    bind();
  }

  [[nodiscard]] std::size_t most_connections() const {
    const auto wanted = static_cast<std::size_t>(options.limits.connections);
    const std::size_t fit = connections_that_fit(kDescriptorsAConnection, kDescriptorsReserved);
    if (fit < wanted) spdlog::warn("descriptors are enough for {} of {} connections (ulimit -n)", fit, wanted);
    return std::min(wanted, fit);
  }

  void load_certificate() {
    tls.emplace(asio::ssl::context::tls_server);
    tls->set_options(asio::ssl::context::default_workarounds | asio::ssl::context::no_sslv3 |
                     asio::ssl::context::no_tlsv1 | asio::ssl::context::no_tlsv1_1);
    beast::error_code error;
    tls->use_certificate_chain_file(options.certificate, error);
    if (error) throw bus::Error(fmt::format("certificate {}: {}", options.certificate, error.message()));
    tls->use_private_key_file(options.key, asio::ssl::context::pem, error);
    if (error) throw bus::Error(fmt::format("key {}: {}", options.key, error.message()));
  }

  void bind() {
    const auto address = parse_host_port(options.http).value();
    std::vector<std::string> hosts{address.host};
    if (address.host == "localhost") hosts = {"127.0.0.1", "::1"};
    std::uint16_t port = address.port;
    for (const std::string& host : hosts) {
      beast::error_code error;
      const auto ip = asio::ip::make_address(host, error);
      if (error) throw bus::Error(fmt::format("http: '{}' is no address of a network interface", host));
      const tcp::endpoint endpoint(ip, port);
      tcp::acceptor acceptor(io);
      acceptor.open(endpoint.protocol(), error);
      if (!error) acceptor.set_option(tcp::acceptor::reuse_address(true), error);
      if (!error) acceptor.bind(endpoint, error);
      if (!error) acceptor.listen(asio::socket_base::max_listen_connections, error);
      if (error && !acceptors.empty()) break;  // a machine without IPv6
      if (error) throw bus::Error(fmt::format("http {}: {}", options.http, error.message()));
      port = acceptor.local_endpoint().port();
      acceptors.push_back(std::move(acceptor));
    }
    const bool named = is_loopback(address.host) || address.host == "0.0.0.0" || address.host == "::";
    const std::string shown = named                                         ? "localhost"
                              : address.host.find(':') == std::string::npos ? address.host
                                                                            : "[" + address.host + "]";
    url = fmt::format("{}://{}:{}", tls ? "https" : "http", shown, port);
  }

  awaitable<void> listen(tcp::acceptor& acceptor) {
    for (;;) {
      auto [error, socket] = co_await acceptor.async_accept(kNoThrow);
      if (error == asio::error::operation_aborted) co_return;
      if (error) {
        if (log_limiter.allow()) spdlog::error("a connection was not accepted: {}", error.message());
        asio::steady_timer pause(io, kTick);
        co_await pause.async_wait(kNoThrow);
        continue;
      }
      beast::error_code gone;
      const auto peer = socket.remote_endpoint(gone);
      if (gone) continue;
      auto lease = connections.admit(key_of(peer.address()));
      if (!lease) {
        if (log_limiter.allow()) spdlog::warn("too many connections, {} in all", traffic.connections);
        continue;
      }
      asio::co_spawn(io, connection(std::move(socket), std::move(*lease)), [this](const std::exception_ptr& thrown) {
        try {
          if (thrown) std::rethrow_exception(thrown);
        } catch (const std::exception& e) {
          if (log_limiter.allow()) spdlog::error("a connection: {}", e.what());
        }
      });
    }
  }

  awaitable<void> connection(tcp::socket socket, ConnectionCounts::Lease lease) {
    const auto held = std::move(lease);
    beast::error_code ignored;
    socket.set_option(tcp::no_delay(true), ignored);
    Tcp stream(std::move(socket));
    stream.rate_policy().read_limit(
        std::max<std::size_t>(1024, static_cast<std::size_t>(options.limits.rate_kbps * 125)));
    if (!tls) {
      co_await serve(std::move(stream));
      co_return;
    }
    Tls secured(std::move(stream), *tls);
    beast::get_lowest_layer(secured).expires_after(seconds(options.limits.handshake_s));
    if (const auto [error] = co_await secured.async_handshake(asio::ssl::stream_base::server, kNoThrow); !error) {
      co_await serve(std::move(secured));
    }
  }

  /// Requests one after the other, until one becomes a WebSocket.
  template <class Stream>
  awaitable<void> serve(Stream stream) {
    beast::flat_buffer buffer(kMaxHeaderBytes + BenchLog::kMaxBytes);
    for (int served = 0; served < kRequestsAConnection; ++served) {
      http::request_parser<http::string_body> parser;
      parser.header_limit(kMaxHeaderBytes);
      parser.body_limit(BenchLog::kMaxBytes);
      beast::get_lowest_layer(stream).expires_after(
          seconds(served == 0 ? options.limits.handshake_s : options.limits.idle_s));
      const auto [error, bytes] = co_await http::async_read(stream, buffer, parser, kNoThrow);
      if (error || !is_plain(parser.get())) {
        const bool said_something =
            !error || error.category() == http::make_error_code(http::error::bad_target).category();
        if (error != http::error::end_of_stream && said_something) {
          traffic.refuse(Refusal::Malformed);
          const Response response = refusal_of(error);
          co_await respond(stream, response, false, false);
        }
        break;
      }
      const HttpRequest request = parser.release();
      const bool head = request.method() == http::verb::head;
      if (websocket::is_upgrade(request)) {
        Site::Admission admission = site.admit(view_of(request));
        if (admission.rights && buffer.size() == 0) {
          const auto session = std::make_shared<StreamSession<Stream>>(std::move(stream), relay, std::move(admission));
          co_await session->run(request);
          co_return;
        }
        if (admission.rights) admission.refusal = plain(400, "too early\n");
        co_await respond(stream, admission.refusal, head, false);
        break;
      }
      const bool keep = request.keep_alive() && served + 1 < kRequestsAConnection;
      const Response response = site.answer(view_of(request), bus::now_ns());
      if (!co_await respond(stream, response, head, keep)) break;
    }
    co_await finish(stream);
  }

  static Response refusal_of(const beast::error_code& error) {
    if (error == http::error::header_limit || error == http::error::buffer_overflow)
      return plain(431, "header too large\n");
    if (error == http::error::body_limit) return plain(413, "body too large\n");
    return plain(400, "not understood\n");
  }

  awaitable<void> keep_ticking(const std::stop_token& stop, const std::function<void()>& tick) {
    asio::steady_timer timer(io);
    for (int count = 0; !stop.stop_requested(); ++count) {
      tick();
      const std::int64_t now = bus::now_ns();
      relay.check(now);
      if (count % 10 == 0 && site.refresh_tokens()) renew_rights();
      timer.expires_after(kTick);
      co_await timer.async_wait(kNoThrow);
    }
    io.stop();
  }

  void renew_rights() {
    for (Browser* browser : std::vector<Browser*>(relay.browsers.begin(), relay.browsers.end())) {
      const auto rights = site.rights_of(browser->token);
      if (rights) browser->rights = *rights;
      if (!rights) browser->stop();
    }
  }

  const Options& options;
  Site& site;
  Traffic& traffic;
  bus::LogLimiter log_limiter;
  Relay relay;
  ConnectionCounts connections;
  std::optional<asio::ssl::context> tls;
  asio::io_context io{1};  ///< after all that its coroutines use
  std::vector<tcp::acceptor> acceptors;
  std::string url;
};

Server::Server(const Options& options, std::string streamer_endpoint, Site& site, Traffic& traffic)
    : impl_(std::make_unique<Impl>(options, std::move(streamer_endpoint), site, traffic)) {}

Server::~Server() = default;

void Server::run(const std::stop_token& stop, const std::function<void()>& tick) {
  for (tcp::acceptor& acceptor : impl_->acceptors) asio::co_spawn(impl_->io, impl_->listen(acceptor), asio::detached);
  asio::co_spawn(impl_->io, impl_->keep_ticking(stop, tick), [](const std::exception_ptr& thrown) {
    if (thrown) std::rethrow_exception(thrown);
  });
  impl_->io.run();
}

const std::string& Server::url() const {
  return impl_->url;
}

}  // namespace splatbus::gateway
