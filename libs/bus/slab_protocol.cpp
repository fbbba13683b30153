#include "bus/slab_protocol.h"

#include <fmt/format.h>
#include <sys/socket.h>
#include <sys/uio.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

#include "bus/error.h"

namespace splatbus::bus {
namespace {

constexpr std::uint32_t packet_magic = 0x42414c53;  // "SLAB"
constexpr std::uint16_t packet_version = 2;
constexpr std::uint64_t kept_flag = 1;
constexpr std::size_t max_descriptors = 2;

struct RawPacket {
  std::uint32_t magic;
  std::uint16_t version;
  std::uint16_t operation;
  std::uint32_t status;
  std::uint32_t kind;
  std::uint64_t id;
  std::uint64_t slots;
  std::uint64_t slot_bytes;
  std::uint64_t flags;
  char name[max_slab_name + 1];
  char text[256];
};
static_assert(sizeof(RawPacket) == 496);

std::string terminated(const char* text, std::size_t room) {
  return {text, ::strnlen(text, room)};
}

union ControlBuffer {
  cmsghdr aligned;
  char bytes[CMSG_SPACE(max_descriptors * sizeof(int))];
};

// Takes ownership of every descriptor that came, wanted or not.
std::array<FileDescriptor, max_descriptors> take_descriptors(msghdr& message) {
  std::array<FileDescriptor, max_descriptors> result;
  std::size_t taken = 0;
  for (cmsghdr* part = CMSG_FIRSTHDR(&message); part != nullptr; part = CMSG_NXTHDR(&message, part)) {
    if (part->cmsg_level != SOL_SOCKET || part->cmsg_type != SCM_RIGHTS) continue;
    const std::size_t count = (part->cmsg_len - CMSG_LEN(0)) / sizeof(int);
    for (std::size_t i = 0; i < count; ++i) {
      int fd = -1;
      std::memcpy(&fd, CMSG_DATA(part) + i * sizeof(int), sizeof(int));
      FileDescriptor owned(fd);
      if (taken < result.size()) result[taken++] = std::move(owned);
    }
  }
  return result;
}

}  // namespace

void send_slab_packet(int socket, const SlabPacket& packet, int control_fd, int data_fd) {
  RawPacket raw{};
  raw.magic = packet_magic;
  raw.version = packet_version;
  raw.operation = static_cast<std::uint16_t>(packet.operation);
  raw.status = static_cast<std::uint32_t>(packet.status);
  raw.kind = static_cast<std::uint32_t>(packet.descriptor.kind);
  raw.id = packet.descriptor.id;
  raw.slots = packet.descriptor.slots;
  raw.slot_bytes = packet.descriptor.slot_bytes;
  raw.flags = packet.descriptor.kept ? kept_flag : 0;
  std::memcpy(raw.name, packet.descriptor.name.data(), std::min(packet.descriptor.name.size(), max_slab_name));
  std::memcpy(raw.text, packet.text.data(), std::min(packet.text.size(), sizeof(raw.text) - 1));

  iovec part{&raw, sizeof(raw)};
  ControlBuffer control{};
  msghdr message{};
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  if (control_fd >= 0) {
    message.msg_control = control.bytes;
    message.msg_controllen = sizeof(control.bytes);
    cmsghdr* rights = CMSG_FIRSTHDR(&message);
    rights->cmsg_level = SOL_SOCKET;
    rights->cmsg_type = SCM_RIGHTS;
    rights->cmsg_len = CMSG_LEN(2 * sizeof(int));
    const int fds[2] = {control_fd, data_fd};
    std::memcpy(CMSG_DATA(rights), fds, sizeof(fds));
  }
  ssize_t sent = 0;
  do {
    sent = ::sendmsg(socket, &message, MSG_NOSIGNAL);
  } while (sent < 0 && errno == EINTR);
  if (sent < 0) throw Error(fmt::format("slab registry: cannot send: {}", std::strerror(errno)));
}

std::optional<SlabPacket> receive_slab_packet(int socket) {
  RawPacket raw{};
  iovec part{&raw, sizeof(raw)};
  ControlBuffer control{};
  msghdr message{};
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  message.msg_control = control.bytes;
  message.msg_controllen = sizeof(control.bytes);
  ssize_t received = 0;
  do {
    received = ::recvmsg(socket, &message, MSG_CMSG_CLOEXEC);
  } while (received < 0 && errno == EINTR);
  if (received < 0) throw Error(fmt::format("slab registry: cannot receive: {}", std::strerror(errno)));
  auto descriptors = take_descriptors(message);
  if (received == 0) return std::nullopt;
  if (received != sizeof(raw) || (message.msg_flags & MSG_TRUNC) != 0 || raw.magic != packet_magic ||
      raw.version != packet_version) {
    throw Error(fmt::format("slab registry: a packet of {} bytes is not one of version {}", received, packet_version));
  }
  SlabPacket packet;
  packet.operation = static_cast<SlabOperation>(raw.operation);
  packet.status = static_cast<SlabStatus>(raw.status);
  packet.descriptor.id = raw.id;
  packet.descriptor.name = terminated(raw.name, sizeof(raw.name));
  packet.descriptor.kind = static_cast<Device>(raw.kind);
  packet.descriptor.slots = raw.slots;
  packet.descriptor.slot_bytes = raw.slot_bytes;
  packet.descriptor.kept = (raw.flags & kept_flag) != 0;
  packet.text = terminated(raw.text, sizeof(raw.text));
  packet.control = std::move(descriptors[0]);
  packet.data = std::move(descriptors[1]);
  return packet;
}

}  // namespace splatbus::bus
