// What a browser sends to the gateway, under the rights that the first byte gives it.
#include "gateway/packet_gate.h"

#include "stream/packets.h"
#include "stream/web_message.h"
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
    const gateway::FramedPacket framed = stream::take_apart(message);
    require(stream::kWebHeaderBytes + framed.packet.size() + framed.payload.size() == message.size(),
            "all of the message, once");
    const bool passes = gateway::examine(framed, rights) == gateway::Passage::Pass;
    const auto body = stream::ParsedPacket::parse(framed.packet, framed.payload).body();
    const bool probes = body == splatbus::wire::Body::Probe || body == splatbus::wire::Body::Quality;
    const bool asks_for_pages = body == splatbus::wire::Body::PageRequest;
    require(passes == ((rights.probe || !probes) && !asks_for_pages),
            "who may not probe does not, and caches go elsewhere");
  } catch (const stream::StreamError&) {  // refused
  }
}
