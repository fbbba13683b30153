#pragma once

#include <functional>
#include <string>

namespace splatbus::bus {

/// Binds an address that may be another process's for a moment yet, of one that is being stopped: `attempt` returns 0
/// or an errno, and is called again for two seconds while that is EADDRINUSE. Throws PermanentError then, and Error at
/// any other errno; `what` begins either's text.
void bind_patiently(const std::string& what, const std::function<int()>& attempt);

}  // namespace splatbus::bus
