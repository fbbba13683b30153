#pragma once

#include <string>

#include "wire/system_generated.h"

namespace splatbus::bus_service {

/// What a heartbeat has too much of, in words that name the field; empty: nothing. The broker keeps each one, and
/// repeats some of all of them in one message.
[[nodiscard]] std::string heartbeat_problem(const wire::Heartbeat& heartbeat, std::size_t body_bytes);

}  // namespace splatbus::bus_service
