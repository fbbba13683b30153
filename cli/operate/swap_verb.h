#pragma once

#include <memory>

#include "control_server.h"
#include "operator_verbs.h"

namespace splatbus::cli {

/// {"verb": "swap", "service": NAME, "wait_s": 60, "backend": "cpu", "set": {"key": "value"}, "program": PATH}; all but
/// the service may be left out. A successor that is not ready within `wait_s` is refused. Before start() of the server.
void add_swap_handler(ControlServer& server, const std::shared_ptr<Operated>& operated);

}  // namespace splatbus::cli
