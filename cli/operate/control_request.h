#pragma once

#include <functional>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>

#include "bus/address.h"
#include "process_output.h"

namespace splatbus::cli {

/// In which a supervisor answers that has nothing to wait for.
inline constexpr double kAnswerWithinS = 10;

/// Asks the supervisor of a bus, and returns its answer; what it says in between goes to `progress`. Throws
/// NoSupervisor, SupervisorSilent when it says nothing for `answer_within_s` beyond what the request lets it take, and
/// std::runtime_error with the supervisor's reason when it refuses.
[[nodiscard]] nlohmann::json ask_supervisor(const bus::Address& bus, nlohmann::json request,
                                            const std::function<void(const std::string&)>& progress = {},
                                            double answer_within_s = kAnswerWithinS);

/// Asks it to stop everything, and returns its answer when it has gone. Throws as ask_supervisor(), and when it has not
/// gone within `wait_s`, else stop_patience_s(): then with what still runs, which goes on being stopped.
[[nodiscard]] nlohmann::json stop_supervisor(const bus::Address& bus, std::optional<double> wait_s);

/// How long an end may take, by the answer to `down`: a minute, or as long as processes may take one after the other.
[[nodiscard]] double stop_patience_s(const nlohmann::json& answer);

/// A line or an event of a process as a JSON object of one line: {"time", "service", "line"} or {"time", "service",
/// "event", "text", "pid", "status" or "signal", "restart_in_s"}.
[[nodiscard]] std::string event_json(const OutputLine& line);

}  // namespace splatbus::cli
