#include "bus/file_descriptor.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/mman.h>
#include <sys/stat.h>
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

FileDescriptor make_sealed_memfd(const std::string& name, std::size_t bytes) {
  FileDescriptor fd(::memfd_create(("splatbus " + name).substr(0, 200).c_str(), MFD_CLOEXEC | MFD_ALLOW_SEALING));
  if (!fd.valid() || ::ftruncate(fd.get(), static_cast<off_t>(bytes)) != 0 ||
      ::fcntl(fd.get(), F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_SEAL) != 0) {
    throw Error(fmt::format("slab '{}': cannot make {} bytes of shared memory: {}", name, bytes, std::strerror(errno)));
  }
  return fd;
}

void require_sealed_memfd(const FileDescriptor& fd, std::size_t bytes, const std::string& what) {
  struct stat status {};
  if (!fd.valid() || ::fstat(fd.get(), &status) != 0) throw Error(what + " did not come with a descriptor");
  const int seals = ::fcntl(fd.get(), F_GET_SEALS);
  if (seals < 0 || (seals & F_SEAL_SHRINK) == 0) throw Error(what + " is not a memfd sealed against shrinking");
  if (status.st_size < 0 || static_cast<std::size_t>(status.st_size) < bytes) {
    throw Error(fmt::format("{} holds {} bytes, less than the {} that it claims", what, status.st_size, bytes));
  }
}

std::byte* map_memory(const FileDescriptor& fd, std::size_t bytes, bool writable, const std::string& name) {
  const int protection = writable ? PROT_READ | PROT_WRITE : PROT_READ;
  const int flags = fd.valid() ? MAP_SHARED : MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE;
  void* mapping = ::mmap(nullptr, bytes, protection, flags, fd.get(), 0);
  if (mapping == MAP_FAILED) {
    throw Error(fmt::format("slab '{}': cannot map {} bytes: {}", name, bytes, std::strerror(errno)));
  }
  return static_cast<std::byte*>(mapping);
}

}  // namespace splatbus::bus
