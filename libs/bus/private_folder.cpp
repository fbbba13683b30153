#include "bus/private_folder.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>

#include "bus/error.h"
#include "bus/file_descriptor.h"
#include "bus/schemes.h"

namespace splatbus::bus {

namespace fs = std::filesystem;

void require_private_folder(const std::string& folder) {
  const auto refuse = [&](const std::string& why) { throw Error(fmt::format("bus folder {}: {}", folder, why)); };
  std::error_code ignored;
  fs::create_directories(fs::path(folder).parent_path(), ignored);
  if (::mkdir(folder.c_str(), 0700) != 0 && errno != EEXIST) {
    refuse(fmt::format("cannot make it: {}", std::strerror(errno)));
  }
  struct stat status {};
  if (::lstat(folder.c_str(), &status) != 0 || !S_ISDIR(status.st_mode)) refuse("it is not a folder");
  // The descriptor is of the very folder that is looked at.
  const FileDescriptor fd(::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC));
  if (status.st_uid != ::geteuid()) refuse(fmt::format("it belongs to another user ({})", status.st_uid));
  if (!fd.valid() || ::fstat(fd.get(), &status) != 0) refuse(std::strerror(errno));
  if (status.st_uid != ::geteuid()) refuse(fmt::format("it belongs to another user ({})", status.st_uid));
  if ((status.st_mode & 077U) == 0) return;
  // Not somebody's home or a folder that many share, named by mistake.
  const bool of_a_bus = fs::is_empty(folder, ignored) || fs::exists(folder + "/lock", ignored);
  if (!of_a_bus || ::fchmod(fd.get(), 0700) != 0) refuse("others may enter it: its mode must be 0700");
}

void require_own_endpoint(const std::string& endpoint, EndpointUse use) {
  if (!endpoint.starts_with(ipc_scheme)) return;
  const auto refuse = [&](const std::string& why) { throw Error(fmt::format("{}: {}", endpoint, why)); };
  const std::string path = endpoint.substr(ipc_scheme.size());
  if (path.starts_with('@')) refuse("the owner of a name without a folder cannot be determined");
  const fs::path parent = fs::path(path).parent_path();
  const std::string folder = parent.empty() ? "." : parent.string();
  if (::mkdir(folder.c_str(), 0700) != 0 && errno != EEXIST) {
    refuse(fmt::format("cannot make its folder: {}", std::strerror(errno)));
  }
  const ::uid_t user = ::geteuid();
  struct stat status {};
  const bool is_link = ::lstat(folder.c_str(), &status) == 0 && S_ISLNK(status.st_mode);
  if (is_link && status.st_uid != user && status.st_uid != 0) {
    refuse(fmt::format("its folder is a link of another user ({}), who may point it elsewhere", status.st_uid));
  }
  if (::stat(folder.c_str(), &status) != 0 || !S_ISDIR(status.st_mode)) refuse("it is not in a folder");
  const bool is_sticky = (status.st_mode & S_ISVTX) != 0 && (status.st_uid == 0 || status.st_uid == user);
  if (!is_sticky) {
    if (status.st_uid != user) refuse(fmt::format("its folder belongs to another user ({})", status.st_uid));
    // Many systems give each user a group of his own, of the same number, and have it write to his folders.
    const ::mode_t others = status.st_gid == user ? S_IWOTH : S_IWGRP | S_IWOTH;
    if ((status.st_mode & others) != 0) refuse("others may write to its folder: chmod go-w it");
  }
  const bool is_there = ::lstat(path.c_str(), &status) == 0;
  if (is_there && status.st_uid != user) refuse(fmt::format("it belongs to another user ({})", status.st_uid));
  if (!is_sticky) return;
  if (is_there && (status.st_mode & (S_IWGRP | S_IWOTH)) != 0) refuse("others may write to it");
  if (!is_there && use == EndpointUse::Connect) {
    refuse("nothing listens there yet, and anybody could: everybody may write to its folder");
  }
}

void require_own_peer(int socket, const std::string& what) {
  ucred peer{};
  socklen_t size = sizeof(peer);
  if (::getsockopt(socket, SOL_SOCKET, SO_PEERCRED, &peer, &size) != 0) {
    throw Error(fmt::format("{}: its owner cannot be determined: {}", what, std::strerror(errno)));
  }
  if (peer.uid != ::geteuid()) throw Error(fmt::format("{}: process {} belongs to another user", what, peer.pid));
}

}  // namespace splatbus::bus
