#include <thrust/copy.h>

#include "device/parallel.h"
#include "trainer/gaussian_kernels.h"

namespace splatbus::trainer::kernels {

namespace {

using device::for_each_index;

constexpr std::uint32_t kPageTiers = kPageLanes / kTierLanes;

/// A stripe of the model's tiers.
struct Stripe {
  PagedGaussians gaussians;
  const std::uint64_t* created_step;
  std::uint64_t step;
  float settled;
  std::uint32_t first_tier;

  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER float weight(std::uint32_t i) const {
    const std::uint64_t created = created_step[i];
    return average_weight(settled, kStripes, step > created ? step - created : 0);
  }
};

/// On a GPU an item is one value: consecutive ones are consecutive in memory.
struct AverageValue {
  Stripe stripe;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t item) const {
    const PagedGaussians& gaussians = stripe.gaussians;
    const std::uint32_t row = item / kTierLanes, channel = row % gaussians.active_channels;
    const std::uint32_t tier = stripe.first_tier + row / gaussians.active_channels;
    const IndexRange range = gaussians.ranges[tier / kPageTiers];
    const std::uint32_t lane = tier % kPageTiers * kTierLanes + item % kTierLanes;
    if (range.frozen != 0 || lane >= range.count) return;
    const std::uint32_t i = range.first + lane;
    float& average = *gaussians.memory.value(gaussians.channels + channel, i);
    average += stripe.weight(i) * (*gaussians.memory.value(channel, i) - average);
  }
};

/// On a CPU it is a tier, whose channels share their weights.
struct AverageTier {
  Stripe stripe;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t item) const {
    const PagedGaussians& gaussians = stripe.gaussians;
    const std::uint32_t tier = stripe.first_tier + item, lane = tier % kPageTiers * kTierLanes;
    const IndexRange range = gaussians.ranges[tier / kPageTiers];
    if (range.frozen != 0 || lane >= range.count) return;
    const std::uint32_t first = range.first + lane;
    const std::uint32_t count = range.count - lane < kTierLanes ? range.count - lane : kTierLanes;
    float weight[kTierLanes];
    for (std::uint32_t k = 0; k < count; ++k) weight[k] = stripe.weight(first + k);
    for (std::uint32_t c = 0; c < gaussians.active_channels; ++c) {
      const float* const live = gaussians.memory.value(c, first);
      float* const average = gaussians.memory.value(gaussians.channels + c, first);
      for (std::uint32_t k = 0; k < count; ++k) average[k] += weight[k] * (live[k] - average[k]);
    }
  }
};

/// Items are lanes, of all ranges; those beyond a range's count are nobody's.
constexpr std::uint32_t kNobody = 0xFFFFFFFFU;

SPLATBUS_PORTABLE std::uint32_t index_of(const PagedGaussians& gaussians, std::uint32_t item) {
  const IndexRange range = gaussians.ranges[item / kPageLanes];
  const std::uint32_t lane = item % kPageLanes;
  return lane < range.count ? range.first + lane : kNobody;
}
std::uint32_t items_of(const PagedGaussians& gaussians) {
  return gaussians.range_count * kPageLanes;
}

SPLATBUS_PORTABLE float largest_log_scale(const PagedGaussians& gaussians, std::uint32_t i) {
  constexpr int kScale = ParameterLayout::kLogScale;
  return math::larger(*gaussians.memory.value(kScale + 2, i),
                      math::larger(*gaussians.memory.value(kScale + 1, i), *gaussians.memory.value(kScale, i)));
}

struct MarkPrunable {
  PagedGaussians gaussians;
  FrameScales scales;
  const std::uint64_t* created_step;
  PruneLimits limits;
  std::uint8_t* dead;
  PruneCounts* counts;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t item) const {
    const std::uint32_t i = index_of(gaussians, item);
    if (i == kNobody) return;
    if (gaussians.ranges[item / kPageLanes].frozen != 0) {
      dead[i] = 0;
      return;
    }
    bool finite = true;
    for (std::uint32_t c = 0; c < gaussians.active_channels; ++c) {
      finite = finite && math::is_finite(*gaussians.memory.value(c, i));
    }
    const std::uint64_t created = created_step[i];
    const bool old = (limits.step > created ? limits.step - created : 0) >= limits.min_age_steps;
    const bool useless =
        *gaussians.memory.value(ParameterLayout::kOpacityLogit, i) < limits.min_opacity_logit ||
        largest_log_scale(gaussians, i) + scales.log_scale(gaussians.ranges[item / kPageLanes].frame_id) >
            limits.max_log_scale;
    const bool gone = !finite || (old && useless);
    dead[i] = gone ? 1 : 0;
    if (gone) device::atomic_add(&counts->removed, 1U);
    if (!finite) device::atomic_add(&counts->not_finite, 1U);
  }
};

struct IsDense {
  PagedGaussians gaussians;
  ScreenStatistics statistics;
  float threshold;

  SPLATBUS_PORTABLE_MEMBER bool operator()(std::uint32_t item) const {
    const std::uint32_t i = index_of(gaussians, item);
    if (i == kNobody || gaussians.ranges[item / kPageLanes].frozen != 0 || statistics.steps[i] == 0) return false;
    return statistics.mean2d_norm[i] / static_cast<float>(statistics.steps[i]) >= threshold;
  }
};

/// An item is a page.
struct PageMovement {
  PagedGaussians gaussians;
  bool transfer;
  float* movement;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t item) const {
    const IndexRange range = gaussians.ranges[item];
    float sum = 0, weights = 0;
    for (std::uint32_t i = range.first; range.frozen == 0 && i < range.first + range.count; ++i) {
      const float opacity = 1.0F / (1.0F + expf(-average(ParameterLayout::kOpacityLogit, i)));
      sum += opacity * moved(i);
      weights += opacity;
    }
    movement[item] = weights > 0 ? sum / weights : 0.0F;
  }

 private:
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER float average(int channel, std::uint32_t i) const {
    return *gaussians.memory.value(gaussians.channels + static_cast<std::uint32_t>(channel), i);
  }
  /// The length of three channels of what the present values are from the averages.
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER float apart(int channel, std::uint32_t i) const {
    float square = 0;
    for (int c = channel; c < channel + 3; ++c) {
      const float difference = *gaussians.memory.value(static_cast<std::uint32_t>(c), i) - average(c, i);
      square += difference * difference;
    }
    return sqrtf(square);
  }
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER float moved(std::uint32_t i) const {
    constexpr int kScale = ParameterLayout::kLogScale;
    const float log_scale =
        math::larger(average(kScale + 2, i), math::larger(average(kScale + 1, i), average(kScale, i)));
    constexpr float kShC0 = 0.28209479F;
    return apart(ParameterLayout::kMean, i) * expf(-log_scale) + apart(kScale, i) +
           (transfer ? 1.0F : kShC0) * apart(ParameterLayout::kAppearance, i);
  }
};

struct IndexOfItem {
  PagedGaussians gaussians;
  std::uint32_t* items;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t k) const { items[k] = index_of(gaussians, items[k]); }
};

struct NumberOriginal {
  const std::uint32_t* indices;
  std::uint32_t* copy_of;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t k) const { copy_of[indices[k]] = k + 1; }
};

/// SplitMix64 (Steele, Lea and Flood 2014).
SPLATBUS_PORTABLE std::uint64_t mixed(std::uint64_t x) {
  x += 0x9E3779B97F4A7C15U;
  x = (x ^ (x >> 30U)) * 0xBF58476D1CE4E5B9U;
  x = (x ^ (x >> 27U)) * 0x94D049BB133111EBU;
  return x ^ (x >> 31U);
}

/// Of the standard normal distribution (Box and Muller 1958).
SPLATBUS_PORTABLE float normal_draw(std::uint64_t seed, std::uint64_t number) {
  const std::uint64_t bits = mixed(mixed(seed) + number);
  const float u = (static_cast<float>(bits >> 40U) + 1) * (1.0F / 16777217);  // within (0, 1)
  const float v = static_cast<float>(bits & 0xFFFFFFU) * (1.0F / 16777216);
  return sqrtf(-2 * logf(u)) * cosf(6.2831853F * v);
}

struct Split {
  PagedGaussians gaussians;
  FrameScales scales;
  const std::uint32_t *copy_of, *copies;
  SplitOptions options;
  float log_factor;

  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t item) const {
    const std::uint32_t i = index_of(gaussians, item);
    if (i == kNobody || copy_of[i] == 0) return;
    const std::uint32_t k = copy_of[i] - 1;
    const float log_scale =
        largest_log_scale(gaussians, i) + scales.log_scale(gaussians.ranges[item / kPageLanes].frame_id);
    if (copies[k] == model::kNotInserted || !(log_scale > options.max_clone_log_scale)) return;
    draw(i, 6 * std::uint64_t{k});
    draw(copies[k], 6 * std::uint64_t{k} + 3);
  }

 private:
  SPLATBUS_PORTABLE_MEMBER float& at(int channel, std::uint32_t i) const {
    return *gaussians.memory.value(static_cast<std::uint32_t>(channel), i);
  }
  SPLATBUS_PORTABLE_MEMBER void draw(std::uint32_t i, std::uint64_t first_number) const {
    float local[3];
    for (int axis = 0; axis < 3; ++axis) {
      float& log_scale = at(ParameterLayout::kLogScale + axis, i);
      local[axis] = normal_draw(options.seed, first_number + static_cast<std::uint64_t>(axis)) * expf(log_scale);
      log_scale -= log_factor;
    }
    constexpr int kQ = ParameterLayout::kRotation;
    const float w = at(kQ, i), x = at(kQ + 1, i), y = at(kQ + 2, i), z = at(kQ + 3, i);
    const float unit = 1.0F / sqrtf(w * w + x * x + y * y + z * z);
    const math::Vec3 offset =
        math::rotation_matrix(w * unit, x * unit, y * unit, z * unit) * math::Vec3{local[0], local[1], local[2]};
    at(ParameterLayout::kMean, i) += offset.x;
    at(ParameterLayout::kMean + 1, i) += offset.y;
    at(ParameterLayout::kMean + 2, i) += offset.z;
  }
};

template <class T>
struct SetValue {
  T* values;
  const IndexRange* ranges;
  T value;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t item) const {
    const IndexRange range = ranges[item / kPageLanes];
    const std::uint32_t lane = item % kPageLanes;
    if (lane < range.count) values[range.first + lane] = value;
  }
};

struct ReadVisibility {
  model::PageMemory memory;
  const IndexRange* ranges;
  std::uint8_t* of_index;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t item) const {
    const IndexRange range = ranges[item / kPageLanes];
    const std::uint32_t index = range.first + item % kPageLanes;
    if (item % kPageLanes >= range.count) return;
    const float share = math::clamped(*memory.value(memory.visibility, index), 0.0F, 1.0F);
    of_index[index] = static_cast<std::uint8_t>(share * 255.0F + 0.5F);
  }
};

struct CopyVisibility {
  VisibilityRows<const std::uint8_t> values;
  const model::LaneRange* pages;
  VisibilityRows<std::uint8_t> of_index;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t item) const {
    const model::LaneRange page = pages[item / kPageLanes];
    const std::uint32_t index = page.first + item % kPageLanes;
    if (item % kPageLanes >= page.count) return;
    for (std::uint32_t row = 0; row < of_index.rows; ++row) *of_index.at(row, index) = *values.at(row, index);
  }
};

template <class T>
struct MoveValue {
  T* values;
  const std::uint32_t *from, *to;
  SPLATBUS_PORTABLE_MEMBER void operator()(std::uint32_t k) const { values[to[k]] = values[from[k]]; }
};

template <class T>
void move(StreamView stream, T* values, const model::Moves& moves) {
  for_each_index(stream, static_cast<std::uint32_t>(moves.count), MoveValue<T>{values, moves.from, moves.to});
}

}  // namespace

void update_average(StreamView stream, const PagedGaussians& gaussians, const std::uint64_t* created_step,
                    std::uint64_t step, float settled) {
  const std::uint64_t tiers = std::uint64_t{gaussians.range_count} * kPageTiers, stripe = step % kStripes;
  const auto first = static_cast<std::uint32_t>(tiers * stripe / kStripes);
  const auto end = static_cast<std::uint32_t>(tiers * (stripe + 1) / kStripes);
  const Stripe turn{gaussians, created_step, step, settled, first};
  if (stream.on_cuda()) {
    for_each_index(stream, (end - first) * gaussians.active_channels * kTierLanes, AverageValue{turn});
  } else {
    for_each_index(stream, end - first, AverageTier{turn});
  }
}

void mark_prunable(StreamView stream, const PagedGaussians& gaussians, const FrameScales& scales,
                   const std::uint64_t* created_step, const PruneLimits& limits, std::uint8_t* dead,
                   PruneCounts* counts) {
  for_each_index(stream, items_of(gaussians), MarkPrunable{gaussians, scales, created_step, limits, dead, counts});
}

std::vector<float> page_movements(StreamView stream, const PagedGaussians& gaussians, Appearance appearance) {
  device::Buffer<float> movement(stream, gaussians.range_count);
  for_each_index(stream, gaussians.range_count,
                 PageMovement{gaussians, appearance == Appearance::Transfer, movement.data()});
  return movement.to_host();
}

std::uint32_t list_dense(StreamView stream, const PagedGaussians& gaussians, const ScreenStatistics& statistics,
                         float threshold, std::uint32_t* indices) {
  const auto count = device::with_policy(stream, [&](auto&& policy) {
    const auto first = thrust::make_counting_iterator(std::uint32_t{0});
    const std::uint32_t* const end =
        thrust::copy_if(policy, first, first + items_of(gaussians), indices, IsDense{gaussians, statistics, threshold});
    return static_cast<std::uint32_t>(end - indices);
  });
  for_each_index(stream, count, IndexOfItem{gaussians, indices});
  stream.wait();
  return count;
}

void number_originals(StreamView stream, const std::uint32_t* indices, std::uint32_t count, std::uint32_t* copy_of) {
  for_each_index(stream, count, NumberOriginal{indices, copy_of});
}

void split(StreamView stream, const PagedGaussians& gaussians, const FrameScales& scales, const std::uint32_t* copy_of,
           const std::uint32_t* copies, const SplitOptions& options) {
  for_each_index(stream, items_of(gaussians), Split{gaussians, scales, copy_of, copies, options, logf(kSplitFactor)});
}

void set_values(StreamView stream, std::uint64_t* values, const IndexRange* ranges, std::uint32_t range_count,
                std::uint64_t value) {
  for_each_index(stream, range_count * kPageLanes, SetValue<std::uint64_t>{values, ranges, value});
}
void set_values(StreamView stream, std::uint8_t* values, const IndexRange* ranges, std::uint32_t range_count,
                std::uint8_t value) {
  for_each_index(stream, range_count * kPageLanes, SetValue<std::uint8_t>{values, ranges, value});
}

void move_values(StreamView stream, std::uint64_t* values, const model::Moves& moves) {
  move(stream, values, moves);
}
void move_values(StreamView stream, std::uint32_t* values, const model::Moves& moves) {
  move(stream, values, moves);
}
void move_values(StreamView stream, std::uint8_t* values, const model::Moves& moves) {
  move(stream, values, moves);
}

void read_visibility(StreamView stream, const model::PageMemory& memory, const IndexRange* ranges,
                     std::uint32_t range_count, std::uint8_t* of_index) {
  for_each_index(stream, range_count * kPageLanes, ReadVisibility{memory, ranges, of_index});
}

void copy_visibility(StreamView stream, const VisibilityRows<const std::uint8_t>& values,
                     std::span<const model::LaneRange> pages, const VisibilityRows<std::uint8_t>& of_index) {
  device::Buffer<model::LaneRange> on_device(stream);
  on_device.assign(pages);
  for_each_index(stream, static_cast<std::uint32_t>(pages.size()) * kPageLanes,
                 CopyVisibility{values, on_device.data(), of_index});
  stream.wait();
}

}  // namespace splatbus::trainer::kernels
