#pragma once

#include <functional>
#include <nlohmann/json_fwd.hpp>
#include <string>

#include "bus/address.h"
#include "process_output.h"

namespace splatbus::cli {

/// Asks the supervisor of a bus, and returns its answer; what it says in between goes to `progress`. Throws
/// NoSupervisor, and std::runtime_error with the supervisor's reason when it refuses.
[[nodiscard]] nlohmann::json ask_supervisor(const bus::Address& bus, nlohmann::json request,
                                            const std::function<void(const std::string&)>& progress = {});

/// Asks it to stop everything, and returns when it has gone.
void stop_supervisor(const bus::Address& bus);

/// A line or an event of a process as a JSON object of one line: {"time", "service", "line"} or {"time", "service",
/// "event", "text", "pid", "status" or "signal", "restart_in_s"}.
[[nodiscard]] std::string event_json(const OutputLine& line);

}  // namespace splatbus::cli
