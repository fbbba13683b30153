#pragma once

#include <cstdint>
#include <span>

#include "stream/bytes.h"
#include "stream/quantised.h"

namespace splatbus::stream {

/// A Draco point cloud of all columns in their order: sequential encoder, one GENERIC int32 attribute for each
/// attribute of the layout and one for the object ids, in that order. Lossless on the integers. `gaussians` has 1 to
/// kMaxChunkGaussians columns; Gaussian ids are not in it. Costs least when neighbours in order are neighbours in
/// space.
[[nodiscard]] Bytes encode_chunk(const QuantisedGaussians& gaussians, const StreamLayout& layout);

/// Throws StreamError unless the payload is a chunk of exactly `count` Gaussians of this layout with every value within
/// its limits. Draco sees only payloads whose declarations equal those that encode_chunk writes, so that it allocates
/// no more than they need. gaussian_id comes back 0.
[[nodiscard]] QuantisedGaussians decode_chunk(std::span<const std::uint8_t> payload, const StreamLayout& layout,
                                              std::size_t count);

/// The columns' order along a Morton (Z) curve through their means: column i of the result is the i-th on the curve.
[[nodiscard]] std::vector<std::uint32_t> morton_order(const QuantisedGaussians& gaussians, const StreamLayout& layout,
                                                      std::span<const std::uint32_t> columns);

}  // namespace splatbus::stream
