#pragma once

#include <cstddef>
#include <string>
#include <utility>

namespace splatbus::bus {

/// Owns one file descriptor.
class FileDescriptor {
 public:
  FileDescriptor() = default;
  explicit FileDescriptor(int fd) : fd_(fd) {}
  ~FileDescriptor() { reset(); }
  FileDescriptor(FileDescriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  FileDescriptor& operator=(FileDescriptor&& other) noexcept {
    if (this != &other) {
      reset();
      fd_ = std::exchange(other.fd_, -1);
    }
    return *this;
  }
  FileDescriptor(const FileDescriptor&) = delete;
  FileDescriptor& operator=(const FileDescriptor&) = delete;

  [[nodiscard]] int get() const { return fd_; }
  [[nodiscard]] bool valid() const { return fd_ >= 0; }
  void reset();

  /// Another descriptor of the same file, closed on exec. Throws Error.
  [[nodiscard]] FileDescriptor duplicate() const;

 private:
  int fd_ = -1;
};

/// A memfd of that size whose size nobody can change again. Throws Error naming `name`.
FileDescriptor make_sealed_memfd(const std::string& name, std::size_t bytes);

/// Throws Error beginning with `what` unless `fd` is a memfd of at least `bytes` bytes that cannot be shrunk: mapping a
/// file that its owner shrinks kills the reader with SIGBUS.
void require_sealed_memfd(const FileDescriptor& fd, std::size_t bytes, const std::string& what);

/// Maps a descriptor shared, or anonymous private memory when it is not valid. Throws Error naming `name`.
std::byte* map_memory(const FileDescriptor& fd, std::size_t bytes, bool writable, const std::string& name);

}  // namespace splatbus::bus
