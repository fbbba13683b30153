#include "bus/slab_registry.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <spdlog/spdlog.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <exception>
#include <string_view>
#include <utility>

#include "bus/clock.h"
#include "bus/error.h"
#include "bus/frames.h"
#include "bus/private_folder.h"
#include "bus/slab_memory.h"

namespace splatbus::bus_service {
namespace {

using bus::Error;
using bus::SlabOperation;
using bus::SlabPacket;
using bus::SlabStatus;

constexpr std::size_t max_clients = 512;
constexpr std::size_t max_slabs = 2048;
constexpr std::ptrdiff_t max_sources_of_one = 64;  // as a connection of the relay may have
constexpr timeval send_timeout{1, 0};
constexpr int collect_every_ms = 500;

bus::FileDescriptor listen_at(const std::string& path) {
  bus::FileDescriptor listener(::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (path.size() >= sizeof(address.sun_path)) throw Error(fmt::format("{}: the path is too long", path));
  std::memcpy(address.sun_path, path.c_str(), path.size());
  ::unlink(path.c_str());  // left by a broker that was killed; the lock says that none runs
  const bus::PrivateUmask umask;
  if (!listener.valid() || ::bind(listener.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0 ||
      ::listen(listener.get(), 64) != 0) {
    throw Error(fmt::format("{}: cannot listen: {}", path, std::strerror(errno)));
  }
  return listener;
}

std::string_view source_of(std::string_view name) {
  return name.substr(0, name.find('/'));
}

bool is_open(int socket) {
  pollfd item{socket, POLLRDHUP, 0};
  return ::poll(&item, 1, 0) == 0;
}

}  // namespace

SlabRegistry::SlabRegistry(const std::string& socket_path, std::chrono::milliseconds grace)
    : socket_path_(socket_path),
      listener_(listen_at(socket_path)),
      wake_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)),
      grace_(grace) {
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
    for (const auto& client : clients_) fds.push_back({client.socket.get(), POLLIN, 0});
    const bool waits = [this] {
      const std::scoped_lock lock(mutex_);
      return !abandoned_ns_.empty();
    }();
    if (::poll(fds.data(), fds.size(), waits ? collect_every_ms : -1) < 0) continue;
    // Backwards, as serving a client may take it off the list.
    for (std::size_t i = clients_.size(); i-- > 0;) {
      if (fds[i + 2].revents == 0 || serve(clients_[i])) continue;
      end_leases(clients_[i]);
      clients_.erase(clients_.begin() + static_cast<std::ptrdiff_t>(i));
    }
    if ((fds[1].revents & POLLIN) != 0) accept_client();
    collect();
  }
}

void SlabRegistry::accept_client() {
  bus::FileDescriptor socket(::accept4(listener_.get(), nullptr, nullptr, SOCK_CLOEXEC));
  if (!socket.valid()) {
    // Out of descriptors: the connection stays pending, and poll would turn in circles.
    if (errno == EMFILE || errno == ENFILE) ::usleep(10'000);
    return;
  }
  try {
    if (clients_.size() >= max_clients) throw Error(fmt::format("refused a client beyond {}", max_clients));
    bus::require_own_peer(socket.get(), "a client");
  } catch (const Error& error) {
    if (limiter_.allow()) spdlog::warn("slab registry: {}", error.what());
    return;
  }
  ucred peer{};
  socklen_t size = sizeof(peer);
  ::getsockopt(socket.get(), SOL_SOCKET, SO_PEERCRED, &peer, &size);
  ::setsockopt(socket.get(), SOL_SOCKET, SO_SNDTIMEO, &send_timeout, sizeof(send_timeout));
  clients_.push_back({std::move(socket), next_client_++, peer.pid});
}

bool SlabRegistry::serve(const Client& client) try {
  auto request = bus::receive_slab_packet(client.socket.get());
  if (!request) return false;
  std::shared_ptr<bus::Slab> opened;
  const auto reply = answer(*request, client, opened);
  bus::send_slab_packet(client.socket.get(), reply, opened ? opened->control_fd() : -1,
                        opened ? opened->data_fd() : -1);
  return true;
} catch (const std::exception& error) {
  if (limiter_.allow()) spdlog::warn("{}; dropped that client", error.what());
  return false;
}

void SlabRegistry::take_lease(const std::string& name, const Client& client) {
  const auto source = source_of(name);
  const auto lease = leases_.find(source);
  if (lease != leases_.end() && lease->second != client.number) {
    const auto holder = std::find_if(clients_.begin(), clients_.end(),
                                     [&](const Client& other) { return other.number == lease->second; });
    if (holder != clients_.end() && holder->pid != client.pid && is_open(holder->socket.get())) {
      throw Error(fmt::format("process {} is there as '{}', and it alone writes the slabs of that name", holder->pid,
                              bus::printable(source)));
    }
  }
  const auto of_one = std::ranges::count_if(leases_, [&](const auto& held) { return held.second == client.number; });
  if (of_one >= max_sources_of_one && (lease == leases_.end() || lease->second != client.number)) {
    throw Error(fmt::format("process {} has the slabs of {} sources already", client.pid, of_one));
  }
  leases_.insert_or_assign(std::string(source), client.number);
  if (const auto abandoned = abandoned_ns_.find(source); abandoned != abandoned_ns_.end())
    abandoned_ns_.erase(abandoned);
}

void SlabRegistry::end_leases(const Client& client) {
  const std::scoped_lock lock(mutex_);
  for (auto lease = leases_.begin(); lease != leases_.end();) {
    if (lease->second != client.number) {
      ++lease;
      continue;
    }
    const bool has_slabs =
        std::ranges::any_of(by_name_, [&](const auto& named) { return source_of(named.first) == lease->first; });
    if (has_slabs) abandoned_ns_[lease->first] = bus::now_ns();
    lease = leases_.erase(lease);
  }
}

void SlabRegistry::collect() {
  const std::scoped_lock lock(mutex_);
  const std::int64_t now = bus::now_ns();
  for (auto source = abandoned_ns_.begin(); source != abandoned_ns_.end();) {
    if (now - source->second < std::chrono::nanoseconds(grace_).count()) {
      ++source;
      continue;
    }
    std::vector<std::string> names;
    for (const auto& [name, id] : by_name_) {
      if (source_of(name) == source->first && !by_id_.at(id)->descriptor().kept) names.push_back(name);
    }
    for (const auto& name : names) remove(name);
    if (!names.empty() && limiter_.allow()) {
      spdlog::info("dropped {} slabs of {}, which is gone", names.size(), bus::printable(source->first));
    }
    source = abandoned_ns_.erase(source);
  }
}

SlabPacket SlabRegistry::answer(SlabPacket& request, const Client& client, std::shared_ptr<bus::Slab>& opened) {
  SlabPacket reply;
  reply.operation = SlabOperation::Answer;
  reply.descriptor.id = request.descriptor.id;
  reply.descriptor.name = request.descriptor.name;
  const std::scoped_lock lock(mutex_);
  try {
    switch (request.operation) {
      case SlabOperation::Register:
        take_lease(request.descriptor.name, client);
        add(request);
        return reply;
      case SlabOperation::OpenByName: {
        take_lease(request.descriptor.name, client);
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
        take_lease(request.descriptor.name, client);
        remove(request.descriptor.name);
        return reply;
      case SlabOperation::Answer:
        break;
    }
  } catch (const Error& error) {
    if (limiter_.allow()) spdlog::error("slab registry: {}", bus::printable(error.what(), 300));
    reply.status = SlabStatus::Refused;
    reply.text = error.what();
    return reply;
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
