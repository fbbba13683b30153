// What a process of this user says on the slab registry's socket, descriptors with it: packets of the right size and
// version, or any bytes. Each is answered, or ends its connection alone.
#include "bus/slab_registry.h"

#include <poll.h>
#include <spdlog/spdlog.h>
#include <sys/socket.h>
#include <sys/un.h>

#include <array>
#include <filesystem>
#include <memory>

#include "bus/error.h"
#include "bus/slab_memory.h"
#include "target.h"

namespace {

namespace bus = splatbus::bus;
using splatbus::fuzz::Bytes;
using splatbus::fuzz::require;

constexpr std::size_t kPacketBytes = 496;
constexpr std::array<std::uint8_t, 6> kBegin{'S', 'L', 'A', 'B', 2, 0};
constexpr int kReplyMs = 60'000;

class Registry {
 public:
  Registry() {
    spdlog::set_level(spdlog::level::off);
    std::string name = (std::filesystem::temp_directory_path() / "fuzz-slabs-XXXXXX").string();
    require(::mkdtemp(name.data()) != nullptr, "a folder");
    folder_ = name;
    registry_ = std::make_unique<splatbus::bus_service::SlabRegistry>(path(), std::chrono::milliseconds(0));
    bus::SlabDescriptor descriptor;
    descriptor.id = 7;
    descriptor.name = "maker/frames";
    descriptor.slots = 1;
    descriptor.slot_bytes = 4096;
    slab_ = bus::create_slab_memory(descriptor, true);
  }
  ~Registry() {
    registry_.reset();
    std::filesystem::remove_all(folder_);
  }
  Registry(const Registry&) = delete;
  Registry& operator=(const Registry&) = delete;

  [[nodiscard]] std::string path() const { return folder_ / "slabs"; }
  [[nodiscard]] const bus::Slab& slab() const { return *slab_; }

 private:
  std::filesystem::path folder_;
  std::unique_ptr<splatbus::bus_service::SlabRegistry> registry_;
  std::shared_ptr<bus::Slab> slab_;
};

bus::FileDescriptor connect(const std::string& path) {
  bus::FileDescriptor socket(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0));
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::memcpy(address.sun_path, path.data(), path.size());
  require(::connect(socket.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) == 0, "it listens");
  return socket;
}

void send(int socket, Bytes bytes, const std::vector<int>& descriptors) {
  iovec part{const_cast<std::uint8_t*>(bytes.data()), bytes.size()};
  alignas(cmsghdr) char control[CMSG_SPACE(4 * sizeof(int))] = {};
  msghdr message{};
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  if (!descriptors.empty()) {
    message.msg_control = control;
    message.msg_controllen = CMSG_SPACE(descriptors.size() * sizeof(int));
    cmsghdr* rights = CMSG_FIRSTHDR(&message);
    rights->cmsg_level = SOL_SOCKET;
    rights->cmsg_type = SCM_RIGHTS;
    rights->cmsg_len = CMSG_LEN(descriptors.size() * sizeof(int));
    std::memcpy(CMSG_DATA(rights), descriptors.data(), descriptors.size() * sizeof(int));
  }
  (void)::sendmsg(socket, &message, MSG_NOSIGNAL);
}

/// False when it has closed the connection.
bool answered(int socket) {
  pollfd item{socket, POLLIN, 0};
  require(::poll(&item, 1, kReplyMs) == 1, "an answer, or an end");
  try {
    const auto answer = bus::receive_slab_packet(socket);
    require(!answer || answer->operation == bus::SlabOperation::Answer, "an answer");
    return answer.has_value();
  } catch (const bus::Error&) {  // what was not read when it closed
    return false;
  }
}

}  // namespace

SPLATBUS_FUZZ_TARGET(slab_registry, bytes) {
  static const Registry registry;
  splatbus::fuzz::Input input(bytes);
  const bus::FileDescriptor socket = connect(registry.path());
  const int control = registry.slab().control_fd(), data = registry.slab().data_fd();
  const std::vector<int> sets[] = {{}, {control, data}, {data, control}, {control}, {control, data, data, control}};
  for (bool open = true; open && !input.empty();) {
    const auto choice = input.number();
    std::vector<std::uint8_t> packet;
    if (choice % 2 == 0) {
      const auto said = input.take(kPacketBytes - kBegin.size());
      packet.assign(kBegin.begin(), kBegin.end());
      packet.insert(packet.end(), said.begin(), said.end());
      packet.resize(kPacketBytes);
    } else {
      const auto said = input.take(1 + input.number<std::uint16_t>() % 1024);
      packet.assign(said.begin(), said.end());
    }
    if (packet.empty()) break;
    send(socket.get(), packet, sets[choice / 2 % std::size(sets)]);
    open = answered(socket.get());
  }
}
