#include "bus/local_readers.h"

#include <fmt/format.h>
#include <linux/sockios.h>
#include <sys/ioctl.h>
#include <sys/socket.h>

#include <algorithm>

namespace splatbus::bus_service {
namespace {

constexpr std::size_t max_readers = 1024;
constexpr std::size_t max_prefixes_of_reader = 256;
constexpr std::size_t max_consumers = 16;
constexpr std::int64_t stuck_ns = 3'000'000'000;

std::uint32_t process_of(int fd) {
  ucred peer{};
  socklen_t size = sizeof(peer);
  if (fd < 0 || ::getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &peer, &size) != 0) return 0;
  return static_cast<std::uint32_t>(peer.pid);
}

}  // namespace

void LocalReaders::note(const zmq::message_t& event, const std::string& prefix, bool begins) {
  const auto socket = bus::PeerSocket::of(event);
  if (socket.cookie == 0) return;
  const auto found = readers_.find(socket.cookie);
  if (!begins) {
    if (found != readers_.end()) found->second.prefixes.erase(prefix);
    return;
  }
  if (found == readers_.end() && readers_.size() >= max_readers) return;
  Reader& reader = readers_[socket.cookie];
  if (found == readers_.end())
    reader = {.socket = socket, .pid = process_of(socket.fd), .prefixes = {}, .untaken = 0, .behind_since_ns = 0};
  if (reader.prefixes.size() < max_prefixes_of_reader) reader.prefixes.insert(prefix);
}

void LocalReaders::forget_closed() {
  std::erase_if(readers_, [](const auto& entry) { return !entry.second.socket.is_open(); });
}

void LocalReaders::look(std::int64_t now) {
  for (auto& [cookie, reader] : readers_) {
    int untaken = 0;
    if (bus::cookie_of(reader.socket.fd) != cookie || ::ioctl(reader.socket.fd, SIOCOUTQ, &untaken) != 0) untaken = 0;
    // The kernel lets a Unix socket be filled again only once three quarters of it are taken: of one that is read,
    // there is less at one look or another, however much waits behind it.
    const bool took = untaken < reader.untaken;
    reader.untaken = untaken;
    if (untaken == 0) {
      reader.behind_since_ns = 0;
    } else if (took || reader.behind_since_ns == 0) {
      reader.behind_since_ns = now;
    }
  }
}

std::vector<std::uint32_t> LocalReaders::close_stuck(std::int64_t now) {
  std::vector<std::uint32_t> closed;
  for (auto& [cookie, reader] : readers_) {
    if (reader.behind_since_ns == 0 || now - reader.behind_since_ns < stuck_ns) continue;
    if (bus::cookie_of(reader.socket.fd) != cookie) continue;
    ::shutdown(reader.socket.fd, SHUT_RDWR);  // libzmq closes it, and forgets what was for it
    closed.push_back(reader.pid);
  }
  return closed;
}

std::set<std::string> LocalReaders::names(const std::string& topic,
                                          const std::map<std::string, Liveness::Node>& nodes) const {
  std::set<std::string> result;
  for (const auto& [cookie, reader] : readers_) {
    if (result.size() >= max_consumers) break;
    const bool reads = std::any_of(reader.prefixes.begin(), reader.prefixes.end(),
                                   [&](const std::string& prefix) { return topic.starts_with(prefix); });
    if (!reads) continue;
    bool named = false;
    for (const auto& [source, node] : nodes) {
      if (node.pid != reader.pid || !node.alive || result.size() >= max_consumers) continue;
      result.insert(source);
      named = true;
    }
    if (!named) result.insert(fmt::format("pid {}", reader.pid));
  }
  return result;
}

}  // namespace splatbus::bus_service
