#pragma once

#include <memory>

#include "stream/model_quantizer.h"

namespace splatbus::stream {

/// Views in the memory of the first CUDA device. The integers are made there and kept there from one observation to the
/// next, so that only the values that have changed are brought over, or all of them, packed, when many have. The same
/// integers as the host's, bit for bit. Works on a stream of its own, which quantize() waits for. Throws
/// std::runtime_error.
[[nodiscard]] std::unique_ptr<ModelQuantizer> make_cuda_quantizer();

}  // namespace splatbus::stream
