#pragma once

#include <chrono>
#include <stop_token>

#include "bus/address.h"

namespace splatbus::cli {

/// Throws bus::Error at once when nobody listens at the address, saying what to do: no broker, no permission, an
/// unknown host. Makes no folder.
void require_bus(const bus::Address& address);

/// The same once `wait` is over: until then, or until a stop is asked for, somebody may still come to listen there.
void require_bus(const bus::Address& address, std::chrono::duration<double> wait, const std::stop_token& stop);

}  // namespace splatbus::cli
