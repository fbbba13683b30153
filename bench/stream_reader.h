#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>
#include <zmq.hpp>

#include "stream/packets.h"

namespace splatbus::bench {

/// A viewer's end of the protocol: greets until it is answered, reads, and says what has come. It holds nothing.
struct StreamReader {
  zmq::socket_t socket;
  std::uint32_t max_kbps = 0;
  bool reads = true, served = false;
  std::uint64_t newest = 0, bytes = 0, said_bytes = 0, epoch = 0;
  std::int64_t said_ns = 0, come_ns = 0, longest_gap_ns = 0;

  static StreamReader connect(zmq::context_t& context, const std::string& endpoint) {
    StreamReader reader{.socket = zmq::socket_t(context, zmq::socket_type::dealer)};
    reader.socket.set(zmq::sockopt::linger, 0);
    reader.socket.connect(endpoint);
    return reader;
  }
  void greet(const stream::PacketWriter& writer) {
    if (served) return;
    const auto hello = writer.write(0, 0, wire::Body::Hello, [&](auto& builder) {
      return wire::CreateHelloDirect(builder, "viewer", nullptr, false, 0, nullptr, 0, 0, max_kbps);
    });
    (void)socket.send(zmq::buffer(hello.packet), zmq::send_flags::dontwait);
  }
  void read(std::int64_t now_ns) {
    if (!reads && served) return;
    zmq::message_t frame;
    while (socket.recv(frame, zmq::recv_flags::dontwait)) {
      const auto packet = stream::ParsedPacket::parse({frame.data<std::uint8_t>(), frame.size()}, {});
      bytes += frame.size();
      while (frame.more() && socket.recv(frame)) bytes += frame.size();
      // A streamer that begins anew numbers anew.
      if (packet.body() == wire::Body::Welcome) newest = 0;
      newest = std::max(newest, packet.sequence());
      if (packet.stream_epoch() != 0) epoch = packet.stream_epoch();
      if (come_ns != 0) longest_gap_ns = std::max(longest_gap_ns, now_ns - come_ns);
      come_ns = now_ns;
      served = true;
    }
  }
  void say(const stream::PacketWriter& writer, std::int64_t now_ns) {
    const std::int64_t every_ns = bytes - said_bytes >= 32768 ? 50'000'000 : 250'000'000;
    if (!reads || bytes == said_bytes || now_ns - said_ns < every_ns) return;
    const auto held = writer.write(epoch, 0, wire::Body::Held, [&](auto& builder) {
      return wire::CreateHeldDirect(builder, newest, nullptr, 0, 0, nullptr, nullptr, false, 0, max_kbps);
    });
    (void)socket.send(zmq::buffer(held.packet), zmq::send_flags::dontwait);
    said_bytes = bytes;
    said_ns = now_ns;
  }
};

}  // namespace splatbus::bench
