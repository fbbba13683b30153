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

Passage examine(const FramedPacket& message, const Rights& rights) {
  const auto packet = stream::ParsedPacket::parse(message.packet, message.payload);
  bool allowed = true;
  switch (packet.body()) {
    case wire::Body::Hello:
      allowed = rights.probe || !packet.root().body_as_Hello()->probes();
      break;
    case wire::Body::Pose:
      allowed = rights.steer;
      break;
    case wire::Body::Probe:
    case wire::Body::Quality:
      allowed = rights.probe;
      break;
    default:
      break;
  }
  return allowed ? Passage::Pass : Passage::Forbidden;
}

}  // namespace splatbus::gateway
