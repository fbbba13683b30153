#pragma once

#include <string>

#include "bus/file_descriptor.h"

namespace splatbus::bus_service {

/// Makes the bus's folder, this user's alone, and holds it: binding an ipc:// path that is in use would succeed and
/// steal it. Two locks, which the kernel lets go of when their holder dies: a file in the folder, and a name beside the
/// file system, since a folder that was removed takes its file along.
class DirectoryLock {
 public:
  /// Throws bus::Error naming the folder: it cannot be made, or is another user's; PermanentError: another broker
  /// holds it.
  explicit DirectoryLock(std::string directory);

  /// False once the folder, or the lock in it, has been removed: whoever comes does not find this broker.
  [[nodiscard]] bool intact() const;

 private:
  std::string path_;
  bus::FileDescriptor name_;
  bus::FileDescriptor file_;
};

}  // namespace splatbus::bus_service
