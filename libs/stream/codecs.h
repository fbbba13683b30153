#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "stream/bytes.h"
#include "stream/quantized.h"

namespace splatbus::stream {

/// A Draco point cloud of all columns in their order: sequential encoder, one GENERIC int32 attribute for each
/// attribute of the layout and one for the object ids, in that order. Lossless on the integers. `gaussians` has 1 to
/// kMaxChunkGaussians columns; Gaussian ids are not in it. Costs least when neighbours in order are neighbours in
/// space.
[[nodiscard]] Bytes encode_chunk(const QuantizedGaussians& gaussians, const StreamLayout& layout);

/// Throws StreamError unless the payload is a chunk of exactly `count` Gaussians of this layout with every value within
/// its limits. Draco sees only payloads whose declarations equal those that encode_chunk writes, so that it allocates
/// no more than they need. gaussian_id comes back 0.
[[nodiscard]] QuantizedGaussians decode_chunk(std::span<const std::uint8_t> payload, const StreamLayout& layout,
                                              std::size_t count);

/// The columns' order along a Morton (Z) curve through their means: column i of the result is the i-th on the curve.
[[nodiscard]] std::vector<std::uint32_t> morton_order(const QuantizedGaussians& gaussians, const StreamLayout& layout,
                                                      std::span<const std::uint32_t> columns);

// Payloads of the small packets, before and after Zstandard. Encoders give payload and raw_bytes; decoders take what
// the packet says (count, raw_bytes) as hostile: they bound both, check every value, and throw StreamError.

struct Payload {
  Bytes bytes;  ///< Zstandard
  std::uint32_t raw_bytes = 0;
};

/// Slots, ascending and distinct: gaps less one, in planes; then a plane of zigzag residuals for each channel.
struct Delta {
  std::vector<std::uint32_t> slots;
  std::vector<std::vector<std::int32_t>> residuals;  ///< [channels][slots.size()]
};
[[nodiscard]] Payload encode_delta(const Delta& delta);
/// `held` Gaussians exist: a slot at or above it throws, and so does a count above it.
[[nodiscard]] Delta decode_delta(std::span<const std::uint8_t> payload, std::size_t raw_bytes, std::size_t count,
                                 std::size_t channels, std::size_t held);

[[nodiscard]] Payload encode_slots(std::span<const std::uint32_t> ascending);
[[nodiscard]] std::vector<std::uint32_t> decode_slots(std::span<const std::uint8_t> payload, std::size_t raw_bytes,
                                                      std::size_t count, std::size_t held);

/// Differences to the id before, zigzag, in planes.
[[nodiscard]] Payload encode_ids(std::span<const std::uint64_t> ids);
[[nodiscard]] std::vector<std::uint64_t> decode_ids(std::span<const std::uint8_t> payload, std::size_t raw_bytes,
                                                    std::size_t count);

/// Slots as a Delta's, then planes of object ids.
struct SlotIds {
  std::vector<std::uint32_t> slots, ids;
};
[[nodiscard]] Payload encode_slot_ids(const SlotIds& change);
[[nodiscard]] SlotIds decode_slot_ids(std::span<const std::uint8_t> payload, std::size_t raw_bytes, std::size_t count,
                                      std::size_t held);

/// Slots as a Delta's, then one byte each.
struct SlotValues {
  std::vector<std::uint32_t> slots;
  Bytes values;
};
[[nodiscard]] Payload encode_slot_values(const SlotValues& change);
[[nodiscard]] SlotValues decode_slot_values(std::span<const std::uint8_t> payload, std::size_t raw_bytes,
                                            std::size_t count, std::size_t held);

}  // namespace splatbus::stream
