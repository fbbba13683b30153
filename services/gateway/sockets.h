#pragma once

#include <cstddef>
#include <cstdint>

namespace splatbus::gateway {

/// Bytes that the peer of a TCP connection has acknowledged so far; 0 when the kernel does not say.
[[nodiscard]] std::uint64_t acknowledged_bytes(int socket);

/// Has the kernel take little more than what is on its way, so that what a slow reader cannot have yet waits with us,
/// where it is bounded and can be left out.
void bound_unsent_bytes(int socket);

/// Raises the soft limit on descriptors to the hard one. Returns how many connections fit, each with `per_connection`
/// descriptors, `reserved` being left.
[[nodiscard]] std::size_t connections_that_fit(std::size_t per_connection, std::size_t reserved);

}  // namespace splatbus::gateway
