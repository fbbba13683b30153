#pragma once

#include <cstddef>
#include <string>

#include "bus/file_descriptor.h"

namespace splatbus::bus {

/// A memfd of that size whose size nobody can change again. Throws Error naming `name`.
FileDescriptor make_sealed_memfd(const std::string& name, std::size_t bytes);

/// Throws Error beginning with `what` unless `fd` is a memfd of at least `bytes` bytes that cannot be shrunk: mapping a
/// file that its owner shrinks kills the reader with SIGBUS.
void require_sealed_memfd(const FileDescriptor& fd, std::size_t bytes, const std::string& what);

/// Maps a descriptor shared, or anonymous private memory when it is not valid. Throws Error naming `name`.
std::byte* map_memory(const FileDescriptor& fd, std::size_t bytes, bool writable, const std::string& name);

}  // namespace splatbus::bus
