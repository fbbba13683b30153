#include "bus/directory_lock.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <utility>

#include "bus/error.h"
#include "bus/permanent_error.h"
#include "bus/private_folder.h"

namespace splatbus::bus_service {
namespace {

std::string read_holder(int file) {
  char text[32] = {};
  const auto length = ::pread(file, text, sizeof(text) - 1, 0);
  return length > 0 ? std::string(text, static_cast<std::size_t>(length)) : "unknown";
}

/// The same for one folder by whatever path (FNV-1a): a socket's name is short.
std::string abstract_name(const std::string& directory) {
  std::error_code ignored;
  const auto canonical = std::filesystem::weakly_canonical(directory, ignored).string();
  std::uint64_t hash = 0xcbf29ce484222325;
  for (const char c : canonical) hash = (hash ^ static_cast<std::uint8_t>(c)) * 0x100000001b3;
  return fmt::format("splatbus-bus-{}-{:016x}", ::geteuid(), hash);
}

bus::FileDescriptor unix_socket() {
  bus::FileDescriptor socket(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (!socket.valid()) throw bus::Error(fmt::format("cannot make a socket: {}", std::strerror(errno)));
  return socket;
}

/// Binds the folder's abstract name. Throws bus::PermanentError when another broker of this user has it; another user
/// who took the name to be in the way is not minded.
bus::FileDescriptor take_name(const std::string& directory) {
  const auto name = abstract_name(directory);
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::memcpy(address.sun_path + 1, name.data(), name.size());
  const auto size = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + 1 + name.size());
  const auto* const raw = reinterpret_cast<const sockaddr*>(&address);
  auto socket = unix_socket();
  if (::bind(socket.get(), raw, size) == 0 && ::listen(socket.get(), 8) == 0) return socket;
  const auto client = unix_socket();
  ucred holder{};
  socklen_t credentials = sizeof(holder);
  if (::connect(client.get(), raw, size) == 0) {
    ::getsockopt(client.get(), SOL_SOCKET, SO_PEERCRED, &holder, &credentials);
    if (holder.uid != ::geteuid()) {
      spdlog::warn("another user ({}) holds the name of the bus folder {}", holder.uid, directory);
      return socket;
    }
  }
  throw bus::PermanentError(
      fmt::format("bus folder {}: a broker runs there already (process {})", directory, holder.pid));
}

}  // namespace

DirectoryLock::DirectoryLock(std::string directory) : path_(std::move(directory) + "/lock") {
  const auto folder = std::filesystem::path(path_).parent_path().string();
  bus::require_private_folder(folder);
  name_ = take_name(folder);
  file_ = bus::FileDescriptor(::open(path_.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600));
  if (!file_.valid()) throw bus::Error(fmt::format("{}: cannot open it: {}", path_, std::strerror(errno)));
  if (::flock(file_.get(), LOCK_EX | LOCK_NB) != 0) {
    throw bus::PermanentError(
        fmt::format("bus folder {}: a broker runs there already (process {})", folder, read_holder(file_.get())));
  }
  const auto pid = fmt::format("{}", ::getpid());
  if (::ftruncate(file_.get(), 0) != 0 || ::pwrite(file_.get(), pid.data(), pid.size(), 0) < 0) {
    throw bus::Error(fmt::format("{}: cannot write to it: {}", path_, std::strerror(errno)));
  }
}

bool DirectoryLock::intact() const {
  struct stat there {
  }, ours{};
  return ::lstat(path_.c_str(), &there) == 0 && ::fstat(file_.get(), &ours) == 0 && there.st_dev == ours.st_dev &&
         there.st_ino == ours.st_ino;
}

}  // namespace splatbus::bus_service
