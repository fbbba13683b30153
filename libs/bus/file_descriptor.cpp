#include "bus/file_descriptor.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "bus/error.h"

namespace splatbus::bus {

void FileDescriptor::reset() {
  if (fd_ >= 0) ::close(fd_);
  fd_ = -1;
}

FileDescriptor FileDescriptor::duplicate() const {
  const int copy = ::fcntl(fd_, F_DUPFD_CLOEXEC, 0);
  if (copy < 0) throw Error(fmt::format("cannot duplicate a file descriptor: {}", std::strerror(errno)));
  return FileDescriptor(copy);
}

}  // namespace splatbus::bus
