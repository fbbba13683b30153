#pragma once

#include <memory>

#include "stream/observer.h"

namespace splatbus::stream {

/// Views in the memory of the first CUDA device. The integers are made there and kept there from one observation to the
/// next, so that only the values that have changed are brought over, or all of them, packed, when many have. The same
/// integers as the host's, bit for bit. Works on a stream of its own, which quantise() waits for. Throws
/// std::runtime_error.
[[nodiscard]] std::unique_ptr<Observer> make_cuda_observer();

}  // namespace splatbus::stream
