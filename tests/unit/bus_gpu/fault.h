#pragma once

namespace splatbus::bus_test {

/// Launches a kernel after which the device does no more work for this process.
void launch_fault();

}  // namespace splatbus::bus_test
