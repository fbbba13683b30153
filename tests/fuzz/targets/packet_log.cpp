// A file of what a viewer received, and each message of it as a packet.
#include "stream/packet_log.h"

#include "memory_file.h"
#include "stream/packets.h"
#include "target.h"

namespace stream = splatbus::stream;

SPLATBUS_FUZZ_TARGET(packet_log, bytes) {
  const splatbus::fuzz::MemoryFile file(bytes);
  std::size_t read = 0;
  try {
    stream::PacketLogReader log(file.path());
    while (const auto message = log.next()) {
      read += 8 + message->packet.size() + message->payload.size();
      splatbus::fuzz::require(read <= bytes.size(), "no more than there is");
      (void)stream::ParsedPacket::parse(message->packet, message->payload);
    }
  } catch (const std::runtime_error&) {  // refused
  }
}
