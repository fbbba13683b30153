#pragma once

#include <cstddef>
#include <cstdint>

#include "device/stream.h"
#include "gaussians/pages.h"
#include "stream/coding.h"

// What is done for each value between a model's floats and the integers that travel, on either device in the order of a
// stream. Pointers are to memory of the stream's device. Throws std::runtime_error.
namespace splatbus::stream::kernels {

/// Columns of the stream first, first + 1, ...: Gaussians index, index + 1, ... of the model, which lie in one page.
struct ColumnBlock {
  std::uint32_t first = 0, size = 0;
  std::uint32_t index = 0;
  std::uint32_t frame_id = 0;  ///< of all of them, where the model has no object ids
};
/// The most columns of a block: of a GPU's threads each takes one, of a CPU's a block whose channels stay in its cache.
constexpr std::uint32_t kDeviceBlock = 1, kHostBlock = 512;

/// A model's channels as in GaussiansView, and `count` columns in blocks.
struct ModelChannels {
  std::uint32_t count = 0;
  const ColumnBlock* blocks = nullptr;
  std::uint32_t block_count = 0;
  std::size_t stride = 0;
  std::uint32_t page_shift = kNoPages;
  std::size_t page_stride = 0;
  int channels = 0;                   ///< of `parameters`
  const float* parameters = nullptr;  ///< [channels]
  const float* normal = nullptr;      ///< [3]; null: up, or of no use
  const float* visibility = nullptr;  ///< null: 1, or of no use
  const std::uint32_t* object_id = nullptr;
  const std::uint64_t* gaussian_id = nullptr;

  /// Of an index, in elements of 4 and of 8 bytes.
  SPLATBUS_PORTABLE_MEMBER std::size_t offset(std::uint32_t index) const {
    return (index >> page_shift) * page_stride + (index & ((1U << page_shift) - 1));
  }
  SPLATBUS_PORTABLE_MEMBER std::size_t wide_offset(std::uint32_t index) const {
    return (index >> page_shift) * (page_stride / 2) + (index & ((1U << page_shift) - 1));
  }
};

/// One channel of integers; with Rotation and Normal its two neighbours and its one neighbour as well.
struct ChannelPlan {
  coding::Step step{};
  float unit = 0;  ///< the quantizer's step
  coding::Kind kind{};
  std::int16_t source = 0;   ///< first parameter channel
  std::int16_t first = 0;    ///< among the stream's channels
  std::int16_t storage = 0;  ///< row of `wide` or `narrow`
  bool is_wide = false;
};

constexpr int kMaxPlans = 64;
struct Plans {
  ChannelPlan plan[kMaxPlans];
  std::uint32_t count = 0;
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

struct ObservedCounts {
  std::uint32_t values;                   ///< that changed; those beyond the list's capacity are missing in it
  std::uint32_t usable, object_ids, ids;  ///< not 0: some have changed
};

/// What is kept between observations, `count` columns.
struct Integers {
  std::int32_t* wide = nullptr;    ///< [..][count]
  std::int16_t* narrow = nullptr;  ///< [..][count]
  std::uint8_t* usable = nullptr;
  std::uint32_t* object_id = nullptr;
  std::uint64_t* gaussian_id = nullptr;
};

/// Without capacity nothing is counted either.
struct ChangeList {
  ValueChange* changes = nullptr;
  std::uint32_t capacity = 0;
  ObservedCounts* counts = nullptr;
};

/// Takes the ids over.
void take_ids(const ModelChannels& model, const Integers& integers, ObservedCounts* counts, device::StreamView stream);

/// Takes the object ids over, marks the usable columns, quantizes, and lists the values that have changed. `held` may
/// be null.
void quantize(const ModelChannels& model, const Plans& plans, const HeldRotation* held, const Integers& integers,
              const ChangeList& list, device::StreamView stream);

/// Sorts the logs of the extents into `extents` ([count]), and returns how many are finite: those are the first. Waits.
[[nodiscard]] std::uint32_t sort_extents(const ModelChannels& model, float* extents, device::StreamView stream);

/// An attribute on its way back to floats, and the first of its rows among those that are shown.
struct DisplayPlan {
  float offset = 0, step = 1;
  coding::Kind kind{};
  int channels = 0, row = 0;
};

/// Writes `values` ([plan.channels][count]) of `columns` ([count]) into `rows` ([..][stride]).
void dequantize(const DisplayPlan& plan, const std::int32_t* values, const std::uint32_t* columns, std::uint32_t count,
                float* rows, std::size_t stride, device::StreamView stream);

/// to[columns[i]] = values[i] for i below `count`.
void scatter(const std::uint32_t* values, const std::uint32_t* columns, std::uint32_t count, std::uint32_t* to,
             device::StreamView stream);
void scatter(const std::uint8_t* values, const std::uint32_t* columns, std::uint32_t count, std::uint8_t* to,
             device::StreamView stream);

}  // namespace splatbus::stream::kernels
