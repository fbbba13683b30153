#include "bus/directory_lock.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>

#include "bus/error.h"

namespace splatbus::bus_service {
namespace {

void make_directory(const std::string& directory) {
  std::error_code error;
  const auto parent = std::filesystem::path(directory).parent_path();
  std::filesystem::create_directories(parent, error);
  if (::mkdir(directory.c_str(), 0700) != 0 && errno != EEXIST) {
    throw bus::Error(fmt::format("bus folder {}: cannot make it: {}", directory, std::strerror(errno)));
  }
  struct stat status {};
  if (::lstat(directory.c_str(), &status) != 0 || !S_ISDIR(status.st_mode)) {
    throw bus::Error(fmt::format("bus folder {}: it is not a folder", directory));
  }
  if (status.st_uid != ::geteuid()) {
    throw bus::Error(fmt::format("bus folder {}: it belongs to another user ({})", directory, status.st_uid));
  }
}

std::string read_holder(int file) {
  char text[32] = {};
  const auto length = ::pread(file, text, sizeof(text) - 1, 0);
  return length > 0 ? std::string(text, static_cast<std::size_t>(length)) : "unknown";
}

}  // namespace

DirectoryLock::DirectoryLock(const std::string& directory) {
  make_directory(directory);
  const auto path = directory + "/lock";
  file_ = bus::FileDescriptor(::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600));
  if (!file_.valid()) throw bus::Error(fmt::format("{}: cannot open it: {}", path, std::strerror(errno)));
  if (::flock(file_.get(), LOCK_EX | LOCK_NB) != 0) {
    throw bus::Error(
        fmt::format("bus folder {}: a broker runs there already (process {})", directory, read_holder(file_.get())));
  }
  const auto pid = fmt::format("{}", ::getpid());
  if (::ftruncate(file_.get(), 0) != 0 || ::pwrite(file_.get(), pid.data(), pid.size(), 0) < 0) {
    throw bus::Error(fmt::format("{}: cannot write to it: {}", path, std::strerror(errno)));
  }
}

}  // namespace splatbus::bus_service
