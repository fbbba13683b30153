#pragma once

#include "bus/address.h"

namespace splatbus::cli {

/// Throws bus::Error at once when nobody listens at the address, saying what to do: no broker, no permission, an
/// unknown host. Makes no folder.
void require_bus(const bus::Address& address);

}  // namespace splatbus::cli
