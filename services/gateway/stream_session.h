#pragma once

// Part of server.cpp: of Boost.Beast, which is slow to compile.

#include <array>
#include <span>
#include <string>
#include <utility>

#include "gateway/browser_socket.h"
#include "gateway/packet_gate.h"
#include "gateway/stream_link.h"
#include "gateway/streamers.h"
#include "stream/web_message.h"

namespace splatbus::gateway {

/// Relays between one browser's WebSocket and its link to the streamer.
class StreamSession final : public BrowserSocket {
 public:
  StreamSession(Connection connection, Relay& relay, Site::Admission admission, const stream::StreamerPlace& place)
      : BrowserSocket(std::move(connection), relay, std::move(admission)),
        link_(relay.context, place.endpoint),
        wake_(socket_.get_executor(), link_.descriptor()) {
    streamer = place;
    ++relay.traffic.viewers;
  }
  ~StreamSession() override {
    wake_.release();  // ZeroMQ closes it
    --relay_.traffic.viewers;
  }

  void move() override {
    link_.say_goodbye();
    wake_.release();  // which ends a wait for it
    link_ = StreamLink(relay_.context, streamer->endpoint);
    wake_.assign(link_.descriptor());
    moved_ = true;
  }

 private:
  /// So that it greets its streamer at once, and not when it next says something.
  static StreamPacket question() {
    const auto asks = stream::PacketWriter::brief().write(0, 0, wire::Body::Welcome, [](auto& builder) {
      return wire::CreateWelcome(builder, wire::Appearance::Transfer, 0, 0, 0, true);
    });
    return {.packet = zmq::message_t(asks.packet.data(), asks.packet.size()), .payload = {}};
  }
  asio::awaitable<void> write_messages() override {
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
      const bool written = co_await write(message);
      if (!written) co_return;
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

  StreamLink link_;
  asio::posix::stream_descriptor wake_;
  bool moved_ = false;
};

}  // namespace splatbus::gateway
