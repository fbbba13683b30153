#pragma once

#include <cstdint>

#include "device/memory.h"
#include "model/insert_rows.h"

namespace splatbus::trainer {

using model::InsertRows;

/// Calls visit(name, planes, channels) for the planes of InsertRows, in the order in which they lie in one piece. The
/// names are those of model/insert's tensors.
template <class Rows, class Visit>
void for_each_plane(Rows& rows, Visit&& visit) {
  visit("object_id", rows.object_id, 1U);
  visit("mean", rows.mean, 3U);
  visit("log_scale", rows.log_scale, 3U);
  visit("rotation", rows.rotation, 4U);
  visit("opacity_logit", rows.opacity_logit, 1U);
  visit("albedo", rows.albedo, 3U);
  visit("normal", rows.normal, 3U);
  visit("visibility", rows.visibility, 1U);
}

// What a row of model/insert may be.
inline constexpr std::uint32_t kMaxInsertRows = 1U << 22;
inline constexpr float kMaxDistance_m = 1e6F;
inline constexpr float kMinLogScale = -16.0F, kMaxLogScale = 8.0F;  // a tenth of a micrometre to three kilometres
inline constexpr float kMaxOpacityLogit = 12.0F;
inline constexpr float kUnitTolerance = 0.05F;  // of a normal's length

// Beyond these a value is taken for garbage, and its row is dropped.
inline constexpr float kMaxAnyLogScale = 100.0F;
inline constexpr float kMaxAnyNormal = 2.0F;
inline constexpr float kMaxAny = 1e3F;
inline constexpr float kMinRotationLength = 1e-3F;

/// Writes the rows that can be Gaussians, normalised and clamped, in their order, to `kept`, which has room for all of
/// them. Returns their number. All planes are in memory of the stream's device, `kept` to be written.
[[nodiscard]] std::uint32_t keep_valid_rows(device::StreamView stream, const InsertRows& announced, std::uint32_t rows,
                                            const InsertRows& kept);

}  // namespace splatbus::trainer
