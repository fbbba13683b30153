#pragma once

// Part of server.cpp: of Boost.Beast, which is slow to compile.

#include <array>
#include <cstdint>
#include <exception>
#include <span>
#include <string>
#include <utility>

#include "bus/clock.h"
#include "bus/trace.h"
#include "gateway/browser_socket.h"
#include "gateway/packet_gate.h"
#include "gateway/stream_link.h"
#include "gateway/streamers.h"
#include "stream/packets.h"
#include "stream/web_message.h"

namespace splatbus::gateway {

/// Relays between one browser's WebSocket and its link to the streamer.
class StreamSession final : public BrowserSocket {
 public:
  /// `client`: as StreamLink has it.
  StreamSession(Connection connection, Relay& relay, Site::Admission admission, std::uint64_t client)
      : BrowserSocket(std::move(connection), relay, std::move(admission)),
        client_(client),
        link_(connect_anew()),
        wake_(socket_.get_executor(), link_.descriptor()) {
    ++relay.traffic.viewers;
  }
  ~StreamSession() override {
    wake_.release();  // ZeroMQ closes it
    --relay_.traffic.viewers;
  }

  void move(const stream::StreamerPlace& place) override {
    StreamLink link(relay_.context, place.endpoint, client_);
    link_.say_goodbye();
    wake_.release();  // which ends a wait for it
    link_ = std::move(link);
    wake_.assign(link_.descriptor());
    moved_ = true;
  }

 private:
  /// To the streamer that is chosen. What an offer says may be no place to connect to, or need a key that is not here.
  StreamLink connect_anew() {
    for (int tries = 0; tries < kTries; ++tries) {
      const std::int64_t now_ns = bus::now_ns();
      streamer = relay_.streamers.choose(now_ns);
      try {
        return StreamLink(relay_.context, streamer->endpoint, client_);
      } catch (const std::exception& error) {
        if (relay_.streamers.pass_over(*streamer, error.what(), now_ns)) continue;
        // There is no other, and none will be told of: the page comes again, and by then it may be reached.
        unreachable_ = true;
        break;
      }
    }
    streamer = stream::StreamerPlace();  // until there is another
    return StreamLink(relay_.context, "", client_);
  }

  /// So that it greets its streamer at once, and not when it next says something.
  static StreamPacket question() {
    const auto asks = stream::PacketWriter::brief().write(0, 0, wire::Body::Welcome, [](auto& builder) {
      return wire::CreateWelcome(builder, wire::Appearance::Transfer, 0, 0, 0, true);
    });
    return {.packet = zmq::message_t(asks.packet.data(), asks.packet.size()), .payload = {}};
  }
  asio::awaitable<void> write_messages() override {
    if (unreachable_) {
      close("the streamer cannot be reached");
      co_return;
    }
    StreamPacket packet;
    while (!stopped_ && !closing_) {
      if (std::exchange(moved_, false)) {
        packet = question();
      } else if (!link_.receive(packet)) {
        // Cancelled when a send has emptied it.
        co_await wake_.async_wait(asio::posix::stream_descriptor::wait_read, kNoThrow);
        continue;
      }
      const auto header = stream::web_header(packet.packet.size());
      const std::array<asio::const_buffer, 3> message{asio::buffer(header),
                                                      asio::buffer(packet.packet.data(), packet.packet.size()),
                                                      asio::buffer(packet.payload.data(), packet.payload.size())};
      const std::int64_t begin_ns = bus::now_ns();
      const bool written = co_await write(message);
      if (!written) co_return;
      trace(packet, begin_ns);
    }
  }
  /// Only while somebody asks for `splatbus trace` is a packet looked into. Each page has a track of its own, since the
  /// thread does something else while a page's socket is full.
  void trace(const StreamPacket& packet, std::int64_t begin_ns) const {
    bus::SpanLog& log = bus::SpanLog::of_process();
    if (!log.records()) return;
    try {
      const auto* const bytes = packet.packet.data<std::uint8_t>();
      const auto parsed = stream::ParsedPacket::parse({bytes, packet.packet.size()}, {});
      log.add({.name = "relay to a page",
               .begin_ns = begin_ns,
               .end_ns = bus::now_ns(),
               .capture_ns = parsed.capture_ns(),
               .thread = static_cast<std::uint32_t>(link_.descriptor())});
    } catch (const stream::StreamError&) {
      // The page says so.
    }
  }
  void wake_writer() override { wake_.cancel(); }

  std::string take(std::span<const std::uint8_t> message, bool binary) override {
    if (!binary) return "no packet";
    try {
      const FramedPacket packet = stream::take_apart(message);
      if (examine(packet, rights) == Passage::Forbidden) {
        relay_.traffic.refuse(Refusal::Forbidden);
      } else if (link_.send(packet, rights)) {
        wake_.cancel();
      }
      return {};
    } catch (const stream::StreamError&) {
      return "no packet";
    }
  }

  static constexpr int kTries = 8;
  std::uint64_t client_;
  bool unreachable_ = false;
  StreamLink link_;
  asio::posix::stream_descriptor wake_;
  bool moved_ = false;
};

}  // namespace splatbus::gateway
