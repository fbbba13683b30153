#pragma once

#include <functional>
#include <string>

namespace splatbus::bus {

/// What the text of a parameter has to be: `holds` decides, `expected` says it ("a point x,y,z").
struct TextRule {
  std::string expected;
  std::function<bool(const std::string&)> holds;
};

/// Empty, or ZeroMQ's tcp://HOST:PORT (the host or the port may be *) or ipc://PATH.
[[nodiscard]] TextRule endpoint_rule();
/// The same, or a gateway's ws:// or wss:// address.
[[nodiscard]] TextRule viewer_endpoint_rule();

}  // namespace splatbus::bus
