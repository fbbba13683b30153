#include "stream/stream_model.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <numeric>
#include <unordered_set>

#include "stream/bytes.h"
#include "stream/codecs.h"
#include "stream/delta_selection.h"

namespace splatbus::stream {

StreamModel::StreamModel(PacketWriter writer, std::uint64_t stream_epoch, const StreamOptions& options, Device device)
    : writer_(std::move(writer)),
      options_(options),
      quantizer_(device),
      selection_(StreamLayout{}, options_.schedules, options_.calm_ticks) {
  assert(options_.chunk_gaussians > 0 && options_.chunk_gaussians <= kMaxChunkGaussians);
  held_.epoch = stream_epoch;
}

void StreamModel::set_schedules(const Schedules& schedules) {
  options_.schedules = schedules;
  selection_.set_schedules(schedules);
}

std::vector<std::uint32_t> StreamModel::slots_of(std::span<const std::uint64_t> ids) const {
  std::vector<std::uint32_t> slots(ids.size(), kNotHeld);
  for (std::size_t i = 0; i < ids.size(); ++i) {
    // Columns mostly stay where they were: look there first.
    const std::uint32_t before = i < slot_of_column_.size() ? slot_of_column_[i] : kNotHeld;
    if (before < held_.gaussians.count() && held_.gaussians.gaussian_id[before] == ids[i]) {
      slots[i] = before;
    } else if (const auto found = slot_of_id_.find(ids[i]); found != slot_of_id_.end()) {
      slots[i] = found->second;
    }
  }
  return slots;
}

bool StreamModel::observe(const GaussiansView& gaussians, const std::function<bool()>& still_valid) {
  if (gaussians.count > kMaxModelGaussians) {
    throw StreamError(fmt::format("model: {} Gaussians, at most {} can be read", gaussians.count, kMaxModelGaussians));
  }
  const bool another = !target_layout_ || !target_layout_->carries(gaussians.layout);
  const StreamLayout layout =
      another || !ready_ ? StreamLayout(gaussians.layout, quantizer_.choose_mean_step(gaussians)) : *target_layout_;
  const bool mirrored = ready_ && !another;
  const std::span<const std::uint64_t> ids = quantizer_.ids(gaussians);
  const std::vector<std::uint32_t> slots = mirrored ? slots_of(ids) : std::vector<std::uint32_t>(ids.size(), kNotHeld);
  quantizer_.quantize(gaussians, layout, mirrored ? &held_.gaussians : nullptr, slots);
  if (still_valid && !still_valid()) return false;

  if (another) set_ready(false);
  quantizer_.commit(target_, usable_);
  target_layout_ = layout;
  if (gaussians.has_pages()) {
    target_ranges_.assign(gaussians.ranges.begin(), gaussians.ranges.end());
  } else {
    target_ranges_ = {{.first = 0, .count = static_cast<std::uint32_t>(gaussians.count)}};
  }
  if (ready_) map_columns();
  return true;
}

void StreamModel::index_ids() {
  slot_of_id_.clear();
  slot_of_id_.reserve(held_.gaussians.count());
  for (std::size_t slot = 0; slot < held_.gaussians.count(); ++slot) {
    slot_of_id_.emplace(held_.gaussians.gaussian_id[slot], static_cast<std::uint32_t>(slot));
  }
}

void StreamModel::map_columns() {
  slot_of_column_ = slots_of(target_.gaussian_id);
  column_of_slot_.assign(held_.gaussians.count(), kNotHeld);
  std::vector<std::uint8_t> present(held_.gaussians.count());
  fresh_.clear();
  for (std::uint32_t column = 0; column < slot_of_column_.size(); ++column) {
    const std::uint32_t slot = slot_of_column_[column];
    if (slot == kNotHeld) {
      if (usable_[column]) fresh_.push_back(column);
    } else if (!present[slot]) {
      present[slot] = 1;
      if (usable_[column]) column_of_slot_[slot] = column;
    }
  }
  gone_.clear();
  for (std::uint32_t slot = 0; slot < present.size(); ++slot) {
    if (!present[slot]) gone_.push_back(slot);
  }
  // An id that comes twice is a mistake of the publisher's; the first one counts.
  std::unordered_set<std::uint64_t> seen;
  std::erase_if(fresh_, [&](std::uint32_t column) { return !seen.insert(target_.gaussian_id[column]).second; });
}

void StreamModel::reset_to_target() {
  assert(observed());
  std::vector<std::uint32_t> usable;
  std::unordered_set<std::uint64_t> seen;
  for (std::uint32_t column = 0; column < target_.count(); ++column) {
    if (usable_[column] && seen.insert(target_.gaussian_id[column]).second) usable.push_back(column);
  }
  if (usable.size() > options_.max_gaussians) usable.resize(options_.max_gaussians);
  const std::scoped_lock lock(mutex_);
  held_.layout = *target_layout_;
  held_.gaussians = target_.gather(morton_order(target_, *target_layout_, usable));
  hold_scene();
  held_.visibility_version = 0;
  visibility_waits_.clear();
  ++held_.sequence;
  selection_ = DeltaSelection(held_.layout, options_.schedules, options_.calm_ticks);
  selection_.append(held_.gaussians);
  slot_of_column_.clear();
  index_ids();
  map_columns();
  ready_ = true;
}

std::size_t StreamModel::room() const {
  return options_.max_gaussians - std::min(options_.max_gaussians, held_.gaussians.count());
}

std::vector<std::size_t> StreamModel::chunk_order(const std::optional<Camera>& camera) const {
  const std::size_t count = held_.gaussians.count(), size = options_.chunk_gaussians;
  std::vector<std::size_t> order((count + size - 1) / size);
  std::iota(order.begin(), order.end(), std::size_t{0});
  if (!camera) return order;
  const auto share = picture_share(held_.gaussians, held_.layout, {&*camera, 1}, held_.scene.objects);
  std::vector<double> score(order.size());
  for (std::size_t i = 0; i < count; ++i) score[i / size] += share[i];
  std::ranges::stable_sort(order, std::greater<>{}, [&](std::size_t chunk) { return score[chunk]; });
  return order;
}

}  // namespace splatbus::stream
