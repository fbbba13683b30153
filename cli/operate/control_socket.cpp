#include "control_socket.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <nlohmann/json.hpp>
#include <utility>

#include "bus/error.h"
#include "bus/private_folder.h"

namespace splatbus::cli {

namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr std::size_t kLongestLine = std::size_t{1} << 22;
constexpr timeval kSendTimeout{5, 0};  // of connections too

sockaddr_un socket_address(const fs::path& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  const std::string& text = path.native();
  if (text.size() >= sizeof(address.sun_path)) throw bus::Error(fmt::format("{}: the path is too long", text));
  std::memcpy(address.sun_path, text.c_str(), text.size());
  return address;
}

bus::FileDescriptor make_socket() {
  bus::FileDescriptor socket(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
  if (!socket.valid()) throw bus::Error(fmt::format("cannot make a socket: {}", std::strerror(errno)));
  return socket;
}

pid_t read_holder(int file) {
  std::array<char, 32> text{};
  return pread(file, text.data(), text.size() - 1, 0) > 0 ? std::atoi(text.data()) : 0;
}

/// Who listens at the other end; 0 where that cannot be said.
pid_t peer_of(int socket) {
  ucred peer{};
  socklen_t size = sizeof(peer);
  return getsockopt(socket, SOL_SOCKET, SO_PEERCRED, &peer, &size) == 0 ? peer.pid : 0;
}

bool is_same_file(const fs::path& path, int fd) {
  struct stat there {
  }, ours{};
  return lstat(path.c_str(), &there) == 0 && fstat(fd, &ours) == 0 && there.st_dev == ours.st_dev &&
         there.st_ino == ours.st_ino;
}

}  // namespace

ControlPaths control_paths(const bus::Address& bus) {
  if (bus.is_local()) {
    const fs::path folder = *bus.directory;
    // Not longer than "slabs" by more than two: Address leaves room for that much in a socket's path.
    return {folder, folder / "launch", folder / "launch.lock"};
  }
  const std::string runtime = fmt::format("/run/user/{}", geteuid());
  std::error_code ignored;
  const bool usable = fs::is_directory(runtime, ignored) && access(runtime.c_str(), W_OK) == 0;
  const fs::path folder =
      usable ? fs::path(runtime) / "splatbus-tcp" : fs::path(fmt::format("/tmp/splatbus-tcp-{}", geteuid()));
  const std::string name = fmt::format("{}:{}", bus.host, bus.port);
  return {folder, folder / name, folder / (name + ".lock")};
}

SupervisorRuns::SupervisorRuns(const bus::Address& bus, pid_t holder)
    : std::runtime_error(fmt::format("a supervisor runs on {} already (process {})", bus.text(), holder)),
      pid(holder) {}

NoSupervisor::NoSupervisor(const bus::Address& bus)
    : std::runtime_error(fmt::format("nothing was launched on {} (start it with 'splatbus up FILE')", bus.text())) {}

SupervisorSilent::SupervisorSilent(pid_t pid, double silent_s)
    : std::runtime_error(fmt::format("the supervisor{} has not answered for {:.3g} s",
                                     pid != 0 ? fmt::format(" (process {})", pid) : "", silent_s)) {}

ControlListener::ControlListener(const bus::Address& bus) : paths_(control_paths(bus)) {
  bus::require_private_folder(paths_.folder);
  lock_ = bus::FileDescriptor(open(paths_.lock.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600));
  if (!lock_.valid()) {
    throw bus::Error(fmt::format("{}: cannot open it: {}", paths_.lock.string(), std::strerror(errno)));
  }
  if (flock(lock_.get(), LOCK_EX | LOCK_NB) != 0) throw SupervisorRuns(bus, read_holder(lock_.get()));
  const std::string pid = fmt::format("{}\n", getpid());
  if (ftruncate(lock_.get(), 0) != 0 || pwrite(lock_.get(), pid.data(), pid.size(), 0) < 0) {
    throw bus::Error(fmt::format("{}: cannot write to it: {}", paths_.lock.string(), std::strerror(errno)));
  }
  const sockaddr_un address = socket_address(paths_.socket);
  unlink(paths_.socket.c_str());  // left by a supervisor that was killed: the lock says that none runs
  listener_ = make_socket();
  const bus::PrivateUmask umask;
  if (bind(listener_.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0 ||
      listen(listener_.get(), 64) != 0) {
    throw bus::Error(fmt::format("{}: cannot listen: {}", paths_.socket.string(), std::strerror(errno)));
  }
}

ControlListener::~ControlListener() {
  // Under the lock, so that it is not a successor's.
  if (listener_.valid() && is_same_file(paths_.lock, lock_.get())) unlink(paths_.socket.c_str());
}

bool ControlListener::intact() const {
  return is_same_file(paths_.lock, lock_.get()) && access(paths_.socket.c_str(), F_OK) == 0;
}

LineSocket::LineSocket(bus::FileDescriptor socket) : socket_(std::move(socket)) {
  bus::require_own_peer(socket_.get(), "the supervisor's socket");
  setsockopt(socket_.get(), SOL_SOCKET, SO_SNDTIMEO, &kSendTimeout, sizeof(kSendTimeout));
}

void LineSocket::set_patience(double seconds) {
  patience_s_ = seconds;
  const auto us = static_cast<std::int64_t>(seconds * 1e6);
  const timeval time{.tv_sec = us / 1'000'000, .tv_usec = us % 1'000'000};
  setsockopt(socket_.get(), SOL_SOCKET, SO_RCVTIMEO, &time, sizeof(time));
}

std::optional<Json> LineSocket::receive() {
  std::size_t searched = 0;
  for (;;) {
    const std::size_t end = buffer_.find('\n', searched);
    if (end != std::string::npos) {
      Json object = Json::parse(buffer_.substr(0, end), nullptr, false);
      buffer_.erase(0, end + 1);
      if (!object.is_object()) throw std::runtime_error("the supervisor's socket: not a JSON object");
      return object;
    }
    searched = buffer_.size();
    if (buffer_.size() > kLongestLine) throw std::runtime_error("the supervisor's socket: the line is too long");
    std::array<char, 16384> chunk{};
    const ssize_t got = recv(socket_.get(), chunk.data(), chunk.size(), 0);
    if (got < 0 && errno == EINTR) continue;
    if (got < 0 && errno == EAGAIN) throw SupervisorSilent(peer_of(socket_.get()), patience_s_);
    if (got <= 0) return {};
    buffer_.append(chunk.data(), static_cast<std::size_t>(got));
  }
}

bool LineSocket::send(const Json& object) {
  // What processes write need not be UTF-8.
  return send_line(object.dump(-1, ' ', false, Json::error_handler_t::replace));
}

bool LineSocket::send_line(std::string line) {
  line.push_back('\n');
  std::size_t sent = 0;
  while (sent < line.size()) {
    const ssize_t done = ::send(socket_.get(), line.data() + sent, line.size() - sent, MSG_NOSIGNAL);
    if (done < 0 && errno == EINTR) continue;
    if (done <= 0) return false;
    sent += static_cast<std::size_t>(done);
  }
  return true;
}

LineSocket connect_control(const bus::Address& bus) {
  const sockaddr_un address = socket_address(control_paths(bus).socket);
  bus::FileDescriptor socket = make_socket();
  setsockopt(socket.get(), SOL_SOCKET, SO_SNDTIMEO, &kSendTimeout, sizeof(kSendTimeout));
  if (connect(socket.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)) != 0) {
    if (errno == ENOENT || errno == ECONNREFUSED || errno == ENOTDIR) throw NoSupervisor(bus);
    if (errno == EAGAIN) throw SupervisorSilent(0, static_cast<double>(kSendTimeout.tv_sec));
    throw bus::Error(
        fmt::format("{}: cannot connect: {}", static_cast<const char*>(address.sun_path), std::strerror(errno)));
  }
  return LineSocket(std::move(socket));
}

}  // namespace splatbus::cli
