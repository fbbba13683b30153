#pragma once

#include "launch_file.h"

namespace splatbus::cli {

/// Refuses names that are taken, dependencies on nobody, and cycles, naming the way round. Throws LaunchError.
void check_order(const LaunchFile& file);

}  // namespace splatbus::cli
