#include "raster/cuda/view_batch.h"

#include <algorithm>
#include <cstring>
#include <iterator>
#include <stdexcept>

#include "raster/cuda/kernels.h"

namespace splatbus::raster::cuda {
namespace {

constexpr std::size_t kAlignment = 64;
constexpr std::size_t kKeptObjects = 1024;  // ids of objects that no view moves any more are kept up to here
constexpr int kStepsToShrink = 64;

std::size_t aligned(std::size_t bytes) {
  return (bytes + kAlignment - 1) / kAlignment * kAlignment;
}

}  // namespace

Targets::Targets(std::span<const TrainView> views) {
  for (const TrainView& view : views) {
    albedo |= view.albedo != nullptr;
    depth |= view.depth != nullptr;
    mask |= view.mask != nullptr;
  }
}

void ViewBatch::choose_objects(std::span<const SceneView> views) {
  const std::vector<std::uint32_t> moving = moving_objects(views);
  if (std::includes(object_ids_.begin(), object_ids_.end(), moving.begin(), moving.end())) return;
  std::vector<std::uint32_t> all;
  std::set_union(object_ids_.begin(), object_ids_.end(), moving.begin(), moving.end(), std::back_inserter(all));
  object_ids_ = all.size() <= kKeptObjects ? all : moving;
  slots_stale_ = true;
  graph.invalidate();
}

/// Room stays while sources come and go; without any for a while, the kernels are those that know none again.
void ViewBatch::choose_source_room(int needed) {
  steps_without_sources_ = needed > 0 ? 0 : steps_without_sources_ + 1;
  const int room = steps_without_sources_ > kStepsToShrink ? 0 : std::max(needed, source_room_);
  if (room == source_room_) return;
  source_room_ = room;
  graph.invalidate();
}

void ViewBatch::lay_out_tables(cudaStream_t stream) {
  const auto views = static_cast<std::size_t>(batch);
  const std::size_t pointers = aligned(views * sizeof(void*));
  color_offset_ = aligned(views * sizeof(DeviceView));
  albedo_offset_ = color_offset_ + pointers;
  depth_offset_ = albedo_offset_ + pointers;
  mask_offset_ = depth_offset_ + pointers;
  limit_offset_ = mask_offset_ + pointers;
  object_offset_ = limit_offset_ + aligned(views * sizeof(float));
  source_offset_ = object_offset_ + aligned(views * (1 + object_ids_.size()) * sizeof(ObjectView));
  const std::size_t bytes =
      source_offset_ + aligned(views * static_cast<std::size_t>(source_room_) * sizeof(ShadingSource));
  if (bytes == table_bytes_) return;
  device::check(cudaStreamSynchronize(stream), "laying out tables");
  table_bytes_ = bytes;
  ring_.resize(kSlots * bytes);
  tables_.resize(bytes);
  device_turn_.clear(stream);
  turn_ = 0;
  graph.invalidate();
}

void ViewBatch::set_views(std::span<const TrainView> views, std::span<const float> loss_limits, Appearance appearance,
                          cudaStream_t stream) {
  std::vector<SceneView> scenes;
  std::vector<const std::uint8_t*> colors, albedos, masks;
  std::vector<const float*> depths;
  for (const TrainView& view : views) {
    scenes.push_back(view.view);
    colors.push_back(view.color);
    albedos.push_back(view.albedo);
    depths.push_back(view.depth);
    masks.push_back(view.mask);
  }
  choose_objects(scenes);
  choose_source_room(max_sources(scenes, appearance));
  lay_out_tables(stream);
  const ViewTables tables = make_view_tables(scenes, appearance, object_ids_, source_room_);
  std::byte* const slot = ring_.data() + turn_++ % kSlots * table_bytes_;
  const auto put = [&](std::size_t offset, const auto& values) {
    std::memcpy(slot + offset, values.data(), values.size() * sizeof(values[0]));
  };
  put(0, tables.views);
  put(color_offset_, colors);
  put(albedo_offset_, albedos);
  put(depth_offset_, depths);
  put(mask_offset_, masks);
  put(limit_offset_, loss_limits);
  put(object_offset_, tables.object_views);
  put(source_offset_, tables.sources);
  const Targets targets(views);
  if (targets != targets_) graph.invalidate();
  targets_ = targets;
}

void ViewBatch::copy_tables(StepCounts* counts, cudaStream_t stream) const {
  launch_copy_tables(ring_.data(), kSlots, tables_.data(), table_bytes_, device_turn_.data(), counts, stream);
}

void ViewBatch::follow_model(const DeviceGaussians& gaussians, cudaStream_t stream) {
  if (!slots_stale_) return;
  slots_stale_ = false;
  device_object_ids_.upload(object_ids_.data(), object_ids_.size(), stream);
  slotted_ = gaussians.object_id != nullptr;
  if (!slotted_) return;
  object_slot_.resize(static_cast<std::size_t>(std::max<std::int64_t>({gaussians.stride, gaussians.count, 1})));
  launch_object_slots(gaussians, device_object_ids_.data(), static_cast<int>(object_ids_.size()), object_slot_.data(),
                      stream);
}

void ViewBatch::model_changed(int count, int count_before) {
  slots_stale_ = true;
  graph.invalidate();
  // Many more Gaussians may lie anywhere; a few take what room there is.
  if (count > count_before + count_before / 16) sized_ = false;
}

void ViewBatch::bind(WorkspaceView& w) const {
  w.views = at<DeviceView>(0);
  w.object_views = at<ObjectView>(object_offset_);
  w.object_count = 1 + static_cast<int>(object_ids_.size());
  w.sources = at<ShadingSource>(source_offset_);
  w.source_room = source_room_;
  w.object_ids = device_object_ids_.data();
  w.object_slot = slotted_ ? object_slot_.data() : nullptr;
  const auto far_field = std::ranges::lower_bound(object_ids_, kFarFieldFrame);
  w.far_slot = has_far_field() ? 1 + static_cast<int>(far_field - object_ids_.begin()) : -1;
  w.surface_depths = targets().depth ? depth_targets() : nullptr;
}

void ViewBatch::set_capacity(std::uint32_t isects) {
  if (isects > kMaxIsects) throw std::runtime_error("TrainStep: Gaussians meet more tiles than can be sorted");
  isect_capacity_ = std::min(isects + isects / 8 + 1024, kMaxIsects);
  max_isects_ = 0;
  steps_ = 0;
  graph.invalidate();
}

bool ViewBatch::has_far_field() const {
  return std::ranges::binary_search(object_ids_, kFarFieldFrame);
}

void ViewBatch::set_list_capacity(std::uint32_t ranges) {
  list_capacity_ = ranges + ranges / 4 + 1;
  max_ranges_ = 0;
  graph.invalidate();
}

void ViewBatch::size_by(std::uint32_t isects, std::uint32_t ranges) {
  if (ranges > list_capacity_) set_list_capacity(ranges);
  if (!sized_ || isects > isect_capacity_) set_capacity(isects);
  sized_ = true;
}

void ViewBatch::note_lists(std::uint32_t isects, std::uint32_t ranges) {
  if (ranges > list_capacity_) set_list_capacity(ranges);
  if (isects > isect_capacity_ - isect_capacity_ / 32) return set_capacity(isects);
  max_isects_ = std::max(max_isects_, isects);
  max_ranges_ = std::max(max_ranges_, ranges);
  if (++steps_ < kStepsToShrink) return;
  if (max_ranges_ < list_capacity_ / 2) set_list_capacity(max_ranges_);
  if (max_isects_ < isect_capacity_ / 2) return set_capacity(max_isects_);
  max_isects_ = max_ranges_ = 0;
  steps_ = 0;
}

std::size_t ViewBatch::bytes() const {
  return object_slot_.size() * sizeof(std::uint16_t) + tables_.size() +
         (device_object_ids_.size() + device_turn_.size()) * sizeof(std::uint32_t);
}

}  // namespace splatbus::raster::cuda
