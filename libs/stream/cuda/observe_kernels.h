#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>
#include <cstdint>

#include "stream/coding.h"

// A published model as plain device pointers, and the kernels that bring the integers made from it up to date. All of
// them are enqueued on `stream`, and throw std::runtime_error.
namespace splatbus::stream::cuda {

struct ModelPlanes {
  std::size_t count = 0, stride = 0;
  int channels = 0;                   ///< of `parameters`
  const float* parameters = nullptr;  ///< [channels][stride]
  const float* normal = nullptr;      ///< [3][stride]; null: up, or of no use
  const float* visibility = nullptr;  ///< [stride]; null: 1, or of no use
  const std::uint32_t* object_id = nullptr;
  const std::uint64_t* gaussian_id = nullptr;
};

enum class Coding : std::uint8_t { Plain, Opacity, Albedo, Visibility, Rotation, Normal };

/// One plane of integers; with Rotation and Normal its two neighbours and its one neighbour as well.
struct PlanePlan {
  coding::Step step{};
  float unit = 0;  ///< the quantizer's step
  Coding coding{};
  std::int16_t source = 0;   ///< first parameter channel
  std::int16_t first = 0;    ///< among the stream's channels
  std::int16_t storage = 0;  ///< row of `wide` or `narrow`
  bool is_wide = false;
};

constexpr int kMaxPlans = 64;
struct Plans {
  PlanePlan plan[kMaxPlans];
  int count = 0;
};

/// The rotation that viewers hold of a column, in quantizer steps.
struct HeldRotation {
  std::int16_t x, y, z;
  std::int16_t held;  ///< 0: none is
};

/// Of one value: the stream's channel << kChannelShift | column.
struct ValueChange {
  std::uint32_t where;
  std::int32_t value;
};
constexpr int kChannelShift = 24;

/// Counted on the device, read by the host.
struct ObservedCounts {
  std::uint32_t values;  ///< that changed; those beyond the list's capacity are missing in it
  std::uint32_t usable, object_ids, ids, finite_extents;
};

/// What is kept between observations, `count` columns.
struct Integers {
  std::int32_t* wide = nullptr;    ///< [..][count]
  std::int16_t* narrow = nullptr;  ///< [..][count]
  std::uint8_t* usable = nullptr;
  std::uint32_t* object_id = nullptr;
  std::uint64_t* gaussian_id = nullptr;
};

/// Takes the ids over, and counts those that have changed.
void launch_ids(const ModelPlanes& model, const Integers& integers, ObservedCounts* counts, cudaStream_t stream);

/// Takes the object ids over, marks the usable columns, quantizes, counts what has changed and lists changed values.
/// `held` may be null.
void launch_quantize(const ModelPlanes& model, const Plans& plans, const HeldRotation* held, const Integers& integers,
                     ValueChange* changes, std::uint32_t capacity, ObservedCounts* counts, cudaStream_t stream);

/// Sorted into `extents` ([count]): the finite ones first. Counts those.
void launch_extents(const ModelPlanes& model, float* extents, ObservedCounts* counts, cudaStream_t stream);

}  // namespace splatbus::stream::cuda
