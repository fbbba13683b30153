#pragma once

#include <memory>

#include "control_server.h"
#include "operator_verbs.h"

namespace splatbus::cli {

/// {"verb": "swap", "service": NAME, "backend": "cpu", "set": {"key": "value"}, "program": PATH}; the last three may be
/// left out. Before start() of the server.
void add_swap_handler(ControlServer& server, const std::shared_ptr<Operated>& operated);

}  // namespace splatbus::cli
