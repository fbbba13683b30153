#include "gateway/server.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <exception>
#include <optional>
#include <set>
#include <vector>

#include "bus/log_sink.h"
#include "bus/rendezvous.h"
#include "gateway/connections.h"
#include "gateway/foxglove/session.h"
#include "gateway/http_exchange.h"
#include "gateway/listening.h"
#include "gateway/stream_session.h"

namespace splatbus::gateway {

namespace {

using asio::awaitable;
using asio::ip::tcp;

constexpr int kRequestsAConnection = 1000;
constexpr std::size_t kDescriptorsAConnection = 4, kDescriptorsReserved = 288;
constexpr std::chrono::milliseconds kTick(100), kTurn(10);
/// Somebody else's, who closes it.
struct BorrowedDescriptor {
  asio::posix::stream_descriptor descriptor;
  BorrowedDescriptor(asio::io_context& io, int fd) : descriptor(io, fd) {}
  ~BorrowedDescriptor() { descriptor.release(); }
  BorrowedDescriptor(const BorrowedDescriptor&) = delete;
  BorrowedDescriptor& operator=(const BorrowedDescriptor&) = delete;
};

}  // namespace

struct Server::Impl {
  Impl(const Options& all, Streamers& streamers, Site& to_see, PageLibrary& library, foxglove::Door to_foxglove,
       Traffic& counts)
      : options(all),
        site(to_see),
        pages(library),
        door(to_foxglove),
        traffic(counts),
        relay(all.limits, counts, streamers),
        connections(most_connections(), static_cast<std::size_t>(all.limits.connections_per_address), counts),
        tls(load_certificate(all)),
        library_wake(io, library.descriptor()),
        acceptors(bind(io, all.http)),
        url(url_of(all.http, acceptors.front().local_endpoint().port(), tls.has_value())) {
    relay.context.set(zmq::ctxopt::max_sockets, 2 * static_cast<int>(most_connections()) + 8);
  }

  [[nodiscard]] std::size_t most_connections() const {
    const auto wanted = static_cast<std::size_t>(options.limits.connections);
    const std::size_t fit = connections_that_fit(kDescriptorsAConnection, kDescriptorsReserved);
    if (fit < wanted) spdlog::warn("descriptors are enough for {} of {} connections (ulimit -n)", fit, wanted);
    return std::min(wanted, fit);
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
    // Of one address whichever gateway it comes by; 0 is none.
    const std::uint64_t client = bus::mixed(bus::hash_of(held.address())) | 1U;
    if (!tls) {
      Connection plain(std::move(stream));
      co_await serve(std::move(plain), client);
      co_return;
    }
    Tls secured(std::move(stream), *tls);
    beast::get_lowest_layer(secured).expires_after(seconds(options.limits.handshake_s));
    if (const auto [error] = co_await secured.next_layer().async_handshake(asio::ssl::stream_base::server, kNoThrow);
        !error) {
      Connection whole(std::move(secured));
      co_await serve(std::move(whole), client);
    }
  }

  /// Requests one after the other, until one becomes a WebSocket.
  awaitable<void> serve(Connection connection, std::uint64_t client) {
    Inbound inbound(options.limits, relay.inbound);
    asio::steady_timer turn(io);
    beast::flat_buffer buffer(kMaxHeaderBytes + BenchLog::kMaxBytes);
    for (int served = 0; served < kRequestsAConnection; ++served) {
      http::request_parser<http::string_body> parser;
      parser.header_limit(kMaxHeaderBytes);
      parser.body_limit(BenchLog::kMaxBytes);
      connection.next_layer().expires_after(seconds(served == 0 ? options.limits.handshake_s : options.limits.idle_s));
      const auto [error, bytes] = co_await http::async_read(connection, buffer, parser, kNoThrow);
      if (error || !is_plain(parser.get())) {
        const bool said_something =
            !error || error.category() == http::make_error_code(http::error::bad_target).category();
        if (error != http::error::end_of_stream && said_something) {
          traffic.refuse(Refusal::Malformed);
          const Response response = refusal_of(error);
          co_await respond(connection, response, false, false);
        }
        break;
      }
      while (!inbound.take(bytes, bus::now_ns())) {
        turn.expires_after(kTurn);
        co_await turn.async_wait(kNoThrow);
      }
      const HttpRequest request = parser.release();
      const bool head = request.method() == http::verb::head;
      if (websocket::is_upgrade(request)) {
        Site::Admission admission = site.admit(view_of(request));
        const bool to_stream = admission.subprotocol == kSubprotocol;
        const bool is_early = buffer.size() > 0, has_room = to_stream || door.hub.has_room();
        if (admission.rights && !is_early && has_room) {
          std::shared_ptr<BrowserSocket> session;
          if (to_stream) {
            session = std::make_shared<StreamSession>(std::move(connection), relay, std::move(admission), client);
          } else {
            session = std::make_shared<foxglove::Session>(std::move(connection), relay, door, std::move(admission));
          }
          co_await session->run(request);
          co_return;
        }
        if (admission.rights && !has_room) traffic.refuse(Refusal::Busy);
        if (admission.rights)
          admission.refusal = is_early ? plain(400, "too early\n") : unavailable("too many clients");
        co_await respond(connection, admission.refusal, head, false);
        break;
      }
      const bool keep = request.keep_alive() && served + 1 < kRequestsAConnection;
      const Response response = co_await answer(request);
      if (!co_await respond(connection, response, head, keep)) break;
    }
    co_await finish(connection);
  }

  /// Waits where the answer has to be fetched, or made, first.
  awaitable<Response> answer(const HttpRequest& request) {
    const std::int64_t began_ns = bus::now_ns();
    asio::steady_timer timer(io);
    Response response = site.answer(view_of(request), began_ns);
    while (static_cast<double>(bus::now_ns() - began_ns) / 1e9 < response.pending_s) {
      if (pages.poll(bus::now_ns())) {
        wake_waiting();
      } else {
        timer.expires_after(kTick);
        waiting.insert(&timer);
        co_await timer.async_wait(kNoThrow);
        waiting.erase(&timer);
      }
      response = site.answer(view_of(request), bus::now_ns(), true);
    }
    if (response.pending_s > 0) response = unavailable("nothing has come yet");
    co_return response;
  }
  void wake_waiting() {
    for (asio::steady_timer* timer : waiting) timer->cancel();
  }
  awaitable<void> follow_library() {
    for (;;) {
      if (pages.poll(bus::now_ns())) wake_waiting();
      const auto [error] =
          co_await library_wake.descriptor.async_wait(asio::posix::stream_descriptor::wait_read, kNoThrow);
      // Aborted is what waited for a streamer that has been left.
      if (error && error != asio::error::operation_aborted) co_return;
    }
  }

  awaitable<void> keep_ticking(const std::stop_token& stop, const std::function<void()>& tick) {
    asio::steady_timer timer(io);
    for (int count = 0; !stop.stop_requested(); ++count) {
      tick();
      const std::int64_t now = bus::now_ns();
      relay.check(now);
      relay.streamers.poll(now);
      relay.share(now);
      follow_streamer(now);
      traffic.foxglove = door.hub.figures();
      if (count % 10 == 0 && site.refresh_tokens()) renew_rights();
      timer.expires_after(kTick);
      co_await timer.async_wait(kNoThrow);
    }
    io.stop();
  }

  /// Pages are asked of one streamer for as long as it is there.
  void follow_streamer(std::int64_t now_ns) {
    const auto place = library_place ? relay.streamers.instead_of(*library_place, now_ns)
                                     : std::optional(relay.streamers.choose(now_ns));
    if (!place) return;
    try {
      const bool is_another = pages.ask_at(place->endpoint);
      library_place = place->source.empty() && place->endpoint.empty() ? std::nullopt : place;
      if (!is_another) return;
    } catch (const std::exception& error) {
      relay.streamers.pass_over(*place, error.what(), now_ns);
      return;
    }
    library_wake.descriptor.release();
    library_wake.descriptor.assign(pages.descriptor());
    wake_waiting();
  }

  void renew_rights() {
    for (Browser* browser : std::vector<Browser*>(relay.browsers.begin(), relay.browsers.end())) {
      const auto rights = site.rights_of(browser->token);
      if (rights) browser->rights = *rights;
      if (!rights) browser->close("its token has been withdrawn");
    }
  }

  const Options& options;
  Site& site;
  PageLibrary& pages;
  foxglove::Door door;
  Traffic& traffic;
  bus::LogLimiter log_limiter;
  Relay relay;
  ConnectionCounts connections;
  std::optional<asio::ssl::context> tls;
  std::set<asio::steady_timer*> waiting;
  std::optional<stream::StreamerPlace> library_place;
  asio::io_context io{1};  ///< after all that its coroutines use
  BorrowedDescriptor library_wake;
  std::vector<tcp::acceptor> acceptors;
  std::string url;
};

Server::Server(const Options& options, Streamers& streamers, Site& site, PageLibrary& pages, ModelFiles& models,
               foxglove::Hub& hub, Traffic& traffic)
    : impl_(std::make_unique<Impl>(options, streamers, site, pages, foxglove::Door{hub, models}, traffic)) {}

Server::~Server() = default;

void Server::run(const std::stop_token& stop, const std::function<void()>& tick) {
  for (tcp::acceptor& acceptor : impl_->acceptors) asio::co_spawn(impl_->io, impl_->listen(acceptor), asio::detached);
  asio::co_spawn(impl_->io, impl_->follow_library(), asio::detached);
  asio::co_spawn(impl_->io, impl_->keep_ticking(stop, tick), [](const std::exception_ptr& thrown) {
    if (thrown) std::rethrow_exception(thrown);
  });
  impl_->io.run();
  impl_->door.hub.leave_all();  // which would wake sessions by an io_context that is about to go
}

const std::string& Server::url() const {
  return impl_->url;
}

}  // namespace splatbus::gateway
