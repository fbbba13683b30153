#include "bus/slab_registry.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <spdlog/spdlog.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <utility>

#include "bus/error.h"
#include "bus/frames.h"
#include "bus/slab_memory.h"

namespace splatbus::bus_service {
namespace {

using bus::Error;
using bus::SlabOperation;
using bus::SlabPacket;
using bus::SlabStatus;

constexpr std::size_t max_clients = 512;
constexpr std::size_t max_slabs = 2048;
constexpr timeval send_timeout{1, 0};

bus::FileDescriptor listen_at(const std::string& path) {
  bus::FileDescriptor listener(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (path.size() >= sizeof(address.sun_path)) throw Error(fmt::format("{}: the path is too long", path));
  std::memcpy(address.sun_path, path.c_str(), path.size());
  ::unlink(path.c_str());  // left by a broker that was killed; the lock says that none runs
  if (!listener.valid() || ::bind(listener.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0 ||
      ::listen(listener.get(), 64) != 0) {
    throw Error(fmt::format("{}: cannot listen: {}", path, std::strerror(errno)));
  }
  return listener;
}

}  // namespace

SlabRegistry::SlabRegistry(const std::string& socket_path)
    : socket_path_(socket_path), listener_(listen_at(socket_path)), wake_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
  if (!wake_.valid()) throw Error("cannot make an eventfd");
  thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

SlabRegistry::~SlabRegistry() {
  thread_.request_stop();
  ::eventfd_write(wake_.get(), 1);
  thread_.join();
  ::unlink(socket_path_.c_str());
}

std::shared_ptr<bus::Slab> SlabRegistry::find(std::uint64_t id) {
  const std::scoped_lock lock(mutex_);
  const auto found = by_id_.find(id);
  return found == by_id_.end() ? nullptr : found->second;
}

std::size_t SlabRegistry::size() const {
  const std::scoped_lock lock(mutex_);
  return by_id_.size();
}

void SlabRegistry::run(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    std::vector<pollfd> fds{{wake_.get(), POLLIN, 0}, {listener_.get(), POLLIN, 0}};
    for (const auto& client : clients_) fds.push_back({client.get(), POLLIN, 0});
    if (::poll(fds.data(), fds.size(), -1) < 0) continue;
    // Backwards, as serving a client may take it off the list.
    for (std::size_t i = clients_.size(); i-- > 0;) {
      if (fds[i + 2].revents == 0) continue;
      if (!serve(clients_[i].get())) clients_.erase(clients_.begin() + static_cast<std::ptrdiff_t>(i));
    }
    if ((fds[1].revents & POLLIN) != 0) accept_client();
  }
}

void SlabRegistry::accept_client() {
  bus::FileDescriptor client(::accept4(listener_.get(), nullptr, nullptr, SOCK_CLOEXEC));
  if (!client.valid()) {
    // Out of descriptors: the connection stays pending, and poll would turn in circles.
    if (errno == EMFILE || errno == ENFILE) ::usleep(10'000);
    return;
  }
  if (clients_.size() >= max_clients) {
    spdlog::warn("slab registry: refused a client beyond {}", max_clients);
    return;
  }
  ::setsockopt(client.get(), SOL_SOCKET, SO_SNDTIMEO, &send_timeout, sizeof(send_timeout));
  clients_.push_back(std::move(client));
}

bool SlabRegistry::serve(int client) try {
  auto request = bus::receive_slab_packet(client);
  if (!request) return false;
  std::shared_ptr<bus::Slab> opened;
  const auto reply = answer(*request, opened);
  bus::send_slab_packet(client, reply, opened ? opened->control_fd() : -1, opened ? opened->data_fd() : -1);
  return true;
} catch (const Error& error) {
  spdlog::warn("{}; dropped that client", error.what());
  return false;
}

SlabPacket SlabRegistry::answer(SlabPacket& request, std::shared_ptr<bus::Slab>& opened) {
  SlabPacket reply;
  reply.operation = SlabOperation::Answer;
  reply.descriptor.id = request.descriptor.id;
  reply.descriptor.name = request.descriptor.name;
  const std::scoped_lock lock(mutex_);
  switch (request.operation) {
    case SlabOperation::Register:
      try {
        add(request);
      } catch (const Error& error) {
        spdlog::error("slab registry: {}", bus::printable(error.what(), 300));
        reply.status = SlabStatus::Refused;
        reply.text = error.what();
      }
      return reply;
    case SlabOperation::OpenByName: {
      const auto named = by_name_.find(request.descriptor.name);
      request.descriptor.id = named == by_name_.end() ? 0 : named->second;
      [[fallthrough]];
    }
    case SlabOperation::Open: {
      const auto found = by_id_.find(request.descriptor.id);
      if (found == by_id_.end()) {
        reply.status = SlabStatus::NotFound;
      } else {
        opened = found->second;
        reply.descriptor = opened->descriptor();
      }
      return reply;
    }
    case SlabOperation::Release:
      remove(request.descriptor.name);
      return reply;
    case SlabOperation::Answer:
      break;
  }
  throw Error(fmt::format("slab registry: operation {} does not exist", static_cast<int>(request.operation)));
}

void SlabRegistry::add(SlabPacket& request) {
  const auto& descriptor = request.descriptor;
  if (descriptor.id == 0 || descriptor.name.empty()) throw Error("a slab needs an id and a name");
  if (!request.control.valid() || !request.data.valid()) {
    throw Error(fmt::format("slab '{}' came without its two descriptors", descriptor.name));
  }
  // Mapping it checks every claim.
  auto slab = bus::map_slab_memory(descriptor, std::move(request.control), std::move(request.data), false);
  if (const auto known = by_id_.find(descriptor.id); known != by_id_.end() && known->second->name() != slab->name()) {
    throw Error(fmt::format("slab '{}' has the id of '{}'", slab->name(), known->second->name()));
  }
  remove(slab->name());
  if (by_id_.size() >= max_slabs) throw Error(fmt::format("there are {} slabs already", max_slabs));
  by_name_[slab->name()] = slab->id();
  by_id_[slab->id()] = std::move(slab);
}

void SlabRegistry::remove(const std::string& name) {
  const auto named = by_name_.find(name);
  if (named == by_name_.end()) return;
  by_id_.erase(named->second);
  by_name_.erase(named);
}

}  // namespace splatbus::bus_service
