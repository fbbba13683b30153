#include "gateway/packet_gate.h"

#include "stream/packets.h"

namespace splatbus::gateway {

Passage examine(const FramedPacket& message, const bus::Rights& rights) {
  const auto packet = stream::ParsedPacket::parse(message.packet, message.payload);
  if (packet.body() == wire::Body::PageRequest) return Passage::Forbidden;  // pages are at /page
  const bool probes = packet.body() == wire::Body::Probe || packet.body() == wire::Body::Quality;
  return probes && !rights.probe ? Passage::Forbidden : Passage::Pass;
}

}  // namespace splatbus::gateway
