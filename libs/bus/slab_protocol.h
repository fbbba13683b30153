#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "bus/file_descriptor.h"
#include "bus/slab.h"

namespace splatbus::bus {

/// One packet of the slab registry's SOCK_SEQPACKET socket, in the machine's own byte order. Register and the answer to
/// Open carry two descriptors (control block, data) as SCM_RIGHTS. Register and OpenByName take the lease of the name's
/// source: who holds it alone writes the slabs of that source. docs/protocol.md, "Slab registry".
enum class SlabOperation : std::uint16_t { Register = 1, Open = 2, OpenByName = 3, Release = 4, Answer = 5 };
enum class SlabStatus : std::uint32_t { Ok = 0, NotFound = 1, Refused = 2 };

struct SlabPacket {
  SlabOperation operation = SlabOperation::Answer;
  SlabStatus status = SlabStatus::Ok;
  SlabDescriptor descriptor;
  std::string text;  ///< why it was refused
  FileDescriptor control;
  FileDescriptor data;
};

/// Throws Error when the name has no room in a packet, or the socket takes nothing (the peer is gone, or does not
/// read).
void send_slab_packet(int socket, const SlabPacket& packet, int control_fd, int data_fd);

/// Nullopt at the end of the stream. Throws Error on a malformed packet, and on a timeout of the socket's own.
std::optional<SlabPacket> receive_slab_packet(int socket);

}  // namespace splatbus::bus
