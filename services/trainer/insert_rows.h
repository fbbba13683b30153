#pragma once

#include <cstddef>
#include <cstdint>

namespace splatbus::trainer {

/// Where the rows of a batch lie, in either kind of memory: planes [channels][stride]. Kernels take it as it is.
struct InsertRows {
  std::size_t stride = 0;
  const float* mean = nullptr;
  const float* log_scale = nullptr;
  const float* rotation = nullptr;
  const float* opacity_logit = nullptr;
  const float* albedo = nullptr;
  const float* normal = nullptr;
  const float* visibility = nullptr;
  const std::uint32_t* object_id = nullptr;
  const std::uint64_t* cell = nullptr;
};

/// Calls visit(name, planes, channels) for the planes of InsertRows or InsertBatch, in the order in which they lie in
/// one piece. The names are those of model/insert's tensors.
template <class Rows, class Visit>
void for_each_plane(Rows& rows, Visit&& visit) {
  visit("cell", rows.cell, 1U);
  visit("object_id", rows.object_id, 1U);
  visit("mean", rows.mean, 3U);
  visit("log_scale", rows.log_scale, 3U);
  visit("rotation", rows.rotation, 4U);
  visit("opacity_logit", rows.opacity_logit, 1U);
  visit("albedo", rows.albedo, 3U);
  visit("normal", rows.normal, 3U);
  visit("visibility", rows.visibility, 1U);
}

// What a row of model/insert may be, for the checks in host memory and on the device.
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

}  // namespace splatbus::trainer
