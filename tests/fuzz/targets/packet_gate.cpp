// What a browser sends to the gateway, under the rights that the first byte gives it.
#include "gateway/packet_gate.h"

#include "stream/packets.h"
#include "target.h"

namespace gateway = splatbus::gateway;
namespace stream = splatbus::stream;
using splatbus::fuzz::require;

SPLATBUS_FUZZ_TARGET(packet_gate, bytes) {
  splatbus::fuzz::Input input(bytes);
  splatbus::bus::Rights rights;
  const auto bits = input.number();
  rights.view = true;
  rights.steer = (bits & 1U) != 0;
  rights.probe = (bits & 2U) != 0;
  const auto message = input.rest();
  try {
    const gateway::FramedPacket framed = gateway::unframe(message);
    require(gateway::kFrameHeaderBytes + framed.packet.size() + framed.payload.size() == message.size(),
            "all of the message, once");
    const bool passes = gateway::examine(framed, rights) == gateway::Passage::Pass;
    const auto body = stream::ParsedPacket::parse(framed.packet, framed.payload).body();
    const bool probes = body == splatbus::wire::Body::Probe || body == splatbus::wire::Body::Quality;
    require(passes == (rights.probe || !probes), "who may not probe does not");
  } catch (const stream::StreamError&) {  // refused
  }
}
