#include "gateway/packet_gate.h"

#include <fmt/format.h>

#include "stream/bytes.h"
#include "stream/packets.h"

namespace splatbus::gateway {

FramedPacket unframe(std::span<const std::uint8_t> message) {
  std::size_t packet_bytes = 0;
  for (std::size_t i = 0; i < kFrameHeaderBytes && i < message.size(); ++i) {
    packet_bytes |= std::size_t{message[i]} << (8 * i);
  }
  if (message.size() <= kFrameHeaderBytes || packet_bytes == 0 || packet_bytes > message.size() - kFrameHeaderBytes) {
    throw stream::StreamError(
        fmt::format("a message of {} bytes that names a Packet of {}", message.size(), packet_bytes));
  }
  const auto rest = message.subspan(kFrameHeaderBytes);
  return {.packet = rest.first(packet_bytes), .payload = rest.subspan(packet_bytes)};
}

Passage examine(const FramedPacket& message, const bus::Rights& rights) {
  const auto packet = stream::ParsedPacket::parse(message.packet, message.payload);
  const bool probes = packet.body() == wire::Body::Probe || packet.body() == wire::Body::Quality;
  return probes && !rights.probe ? Passage::Forbidden : Passage::Pass;
}

}  // namespace splatbus::gateway
