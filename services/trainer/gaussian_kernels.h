#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "device/buffer.h"
#include "model/channels.h"
#include "model/insert_rows.h"
#include "model/page_kernels.h"

// What is done to the model's Gaussians between optimizer steps, and to what is kept for each of them beside the model,
// by index; written once for both devices. Pointers are to memory of the stream's device; what returns a value has
// waited for it.
namespace splatbus::trainer::kernels {

using device::StreamView;

/// Which indices are Gaussians, and where their channels lie.
struct PagedGaussians {
  model::PageMemory memory;
  std::uint32_t channels = 0;         ///< of parameters; as many averages follow them
  std::uint32_t active_channels = 0;  ///< that train
  const IndexRange* ranges = nullptr;
  std::uint32_t range_count = 0;
};

/// Weight of the present value in an average that was last updated `steps` ago, `age` steps after it began: `settled`
/// once the Gaussian is old; before that 4 steps / age, so that the average covers the last quarter of a short life and
/// follows what still moves fast. 1 at the beginning.
SPLATBUS_PORTABLE float average_weight(float settled, std::uint64_t steps, std::uint64_t age) {
  if (age == 0) return 1;
  return math::larger(settled, math::smaller(1, 4 * static_cast<float>(steps) / static_cast<float>(age)));
}

/// To spread the memory traffic, each step averages one stripe of the model: all of it once in so many steps.
inline constexpr std::uint64_t kStripes = 8;

/// After step `step`: takes the parameters into the averages of the stripe whose turn it is. `created_step` by index;
/// `settled`: of an old Gaussian's present value, after kStripes steps.
void update_average(StreamView stream, const PagedGaussians& gaussians, const std::uint64_t* created_step,
                    std::uint64_t step, float settled);

/// An object's scale, where it is not 1: its Gaussians' lengths times that are metres.
struct FrameScale {
  std::uint32_t frame_id = kWorldFrame;
  float log_scale = 0;
};
/// Ascending.
struct FrameScales {
  const FrameScale* scales = nullptr;
  std::uint32_t count = 0;

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER float log_scale(std::uint32_t frame_id) const {
    std::uint32_t first = 0, end = count;
    while (first < end) {
      const std::uint32_t middle = first + (end - first) / 2;
      scales[middle].frame_id < frame_id ? first = middle + 1 : end = middle;
    }
    return first < count && scales[first].frame_id == frame_id ? scales[first].log_scale : 0.0F;
  }
};

struct PruneLimits {
  std::uint64_t step = 0, min_age_steps = 0;
  float min_opacity_logit = 0, max_log_scale = 0;  ///< of metres
};
struct PruneCounts {
  std::uint32_t removed = 0, not_finite = 0;
};
/// dead[index] = 1 for the transparent, the huge and those not finite in an active channel, the young only when they
/// are not finite; 0 for others, and for all of a frozen page. Adds to *counts.
void mark_prunable(StreamView stream, const PagedGaussians& gaussians, const FrameScales& scales,
                   const std::uint64_t* created_step, const PruneLimits& limits, std::uint8_t* dead,
                   PruneCounts* counts);

/// Of each range: how far its Gaussians are from their averages, the opaque ones counted most. The mean in standard
/// deviations, the logarithms of the scales and the colour in its own unit are summed: about the part of itself by
/// which a Gaussian's picture would change if it became its average. 0 for a frozen one. Waits.
[[nodiscard]] std::vector<float> page_movements(StreamView stream, const PagedGaussians& gaussians,
                                                Appearance appearance);

/// By index, of the steps that saw a Gaussian: the sum of |dL/d(projected mean)| in NDC, and their number.
struct ScreenStatistics {
  const float* mean2d_norm = nullptr;
  const std::uint32_t* steps = nullptr;
};
/// Lists the indices whose mean gradient is at least `threshold`, ascending; room for range_count * kPageLanes.
[[nodiscard]] std::uint32_t list_dense(StreamView stream, const PagedGaussians& gaussians,
                                       const ScreenStatistics& statistics, float threshold, std::uint32_t* indices);
/// copy_of[indices[k]] = k + 1.
void number_originals(StreamView stream, const std::uint32_t* indices, std::uint32_t count, std::uint32_t* copy_of);

struct SplitOptions {
  float max_clone_log_scale = 0;  ///< of metres; larger ones are split
  std::uint64_t seed = 0;
};
/// How much smaller than a Gaussian the two are into which it is split (Kerbl et al. 2023).
inline constexpr float kSplitFactor = 1.6F;
/// Of each original i (copy_of[i] != 0) that is too large for a clone, and that has a copy, at copies[copy_of[i] - 1]:
/// both are moved to places drawn from it, and become smaller.
void split(StreamView stream, const PagedGaussians& gaussians, const FrameScales& scales, const std::uint32_t* copy_of,
           const std::uint32_t* copies, const SplitOptions& options);

/// For the indices of ranges, each within one page.
void set_values(StreamView stream, std::uint64_t* values, const IndexRange* ranges, std::uint32_t range_count,
                std::uint64_t value);
void set_values(StreamView stream, std::uint8_t* values, const IndexRange* ranges, std::uint32_t range_count,
                std::uint8_t value);
/// What is kept for an index, as Gaussians were moved.
void move_values(StreamView stream, std::uint64_t* values, const model::Moves& moves);
void move_values(StreamView stream, std::uint32_t* values, const model::Moves& moves);
void move_values(StreamView stream, std::uint8_t* values, const model::Moves& moves);

/// The model's own visibility of those indices: of_index[index] = 255 v, rounded.
void read_visibility(StreamView stream, const model::PageMemory& memory, const IndexRange* ranges,
                     std::uint32_t range_count, std::uint8_t* of_index);
/// A row a light, by index.
template <class Byte>
struct VisibilityRows {
  Byte* values = nullptr;
  std::size_t stride = 0;
  std::uint32_t rows = 1;
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER Byte* at(std::uint32_t row, std::uint32_t index) const {
    return values + row * stride + index;
  }
};
/// All rows of of_index for the indices of pages, which lie on the host; waits.
void copy_visibility(StreamView stream, const VisibilityRows<const std::uint8_t>& values,
                     std::span<const model::LaneRange> pages, const VisibilityRows<std::uint8_t>& of_index);

}  // namespace splatbus::trainer::kernels
