#include "streamer/wire_packet.h"

#include "stream/bytes.h"

namespace splatbus::streamer {

WirePacket::WirePacket(const stream::EncodedPacket& packet)
    : body_(packet.body),
      sequence_at_(stream::sequence_offset(packet.packet)),
      packet_(packet.packet.data(), packet.packet.size()),
      payload_(packet.payload.data(), packet.payload.size()) {}

stream::EncodedPacket WirePacket::copy() const {
  const auto bytes = [](const zmq::message_t& message) {
    const auto* data = message.data<std::uint8_t>();
    return stream::Bytes(data, data + message.size());
  };
  return {.body = body_, .sequence = 0, .packet = bytes(packet_), .payload = bytes(payload_)};
}

}  // namespace splatbus::streamer
