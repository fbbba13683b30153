#pragma once

#include <string>

#include "bus/file_descriptor.h"

namespace splatbus::bus_service {

/// Makes the bus's folder, with mode 0700, and holds its lock file: binding an ipc:// path that is in use would succeed
/// and steal it. The kernel lets go of the lock when its holder dies, so that a killed broker is no hindrance.
class DirectoryLock {
 public:
  /// Throws bus::Error naming the folder: it cannot be made, is another user's, or another broker holds it.
  explicit DirectoryLock(const std::string& directory);

 private:
  bus::FileDescriptor file_;
};

}  // namespace splatbus::bus_service
