#pragma once

#include <cstdint>
#include <span>

#include "stream/bytes.h"
#include "stream/quantized_scene.h"

namespace splatbus::stream {

/// What differs from `base`, null for a whole scene. The version is not in it. docs/protocol-stream.md has the bytes.
[[nodiscard]] Bytes encode_scene(const QuantizedScene& scene, const QuantizedScene* base);
/// Throws StreamError on bytes that encode_scene would not have made for this base.
[[nodiscard]] QuantizedScene decode_scene(std::span<const std::uint8_t> bytes, const QuantizedScene* base,
                                          std::uint64_t version);

}  // namespace splatbus::stream
