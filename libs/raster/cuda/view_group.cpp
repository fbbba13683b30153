#include "raster/cuda/view_group.h"

#include <algorithm>
#include <cstring>
#include <iterator>
#include <stdexcept>
#include <string>
#include <type_traits>

#include "raster/cuda/pair_limit.h"

namespace splatbus::raster::cuda {
namespace {

constexpr std::size_t kAlignment = 64;
constexpr std::size_t kKeptObjects = 1024;  // ids of objects that no view moves any more are kept up to here
constexpr int kBuildsToShrink = 64;

std::size_t aligned(std::size_t bytes) {
  return (bytes + kAlignment - 1) / kAlignment * kAlignment;
}

int checked_batch(std::span<const TrainView> views) {
  if (views.empty() || views.size() > static_cast<std::size_t>(kMaxBatch)) {
    throw std::invalid_argument("TrainStep: a group has 1 to " + std::to_string(kMaxBatch) + " views");
  }
  return static_cast<int>(views.size());
}

}  // namespace

Targets::Targets(std::span<const TrainView> views) {
  for (const TrainView& view : views) {
    albedo |= view.albedo != nullptr;
    depth |= view.depth != nullptr;
  }
}

ViewGroup::ViewGroup(std::span<const TrainView> views)
    : batch(checked_batch(views)),
      width(static_cast<int>(views[0].view.camera.width)),
      height(static_cast<int>(views[0].view.camera.height)) {
  const auto tiles = static_cast<std::size_t>((width + kTileSize - 1) / kTileSize) *
                     static_cast<std::size_t>((height + kTileSize - 1) / kTileSize) * static_cast<std::size_t>(batch);
  tile_range_.resize(tiles);
  patch_depth_limit_.resize(tiles * kPatches);
}

void ViewGroup::choose_objects(std::span<const SceneView> views) {
  const std::vector<std::uint32_t> moving = moving_objects(views);
  if (std::includes(object_ids_.begin(), object_ids_.end(), moving.begin(), moving.end())) return;
  std::vector<std::uint32_t> all;
  std::set_union(object_ids_.begin(), object_ids_.end(), moving.begin(), moving.end(), std::back_inserter(all));
  object_ids_ = all.size() <= kKeptObjects ? all : moving;
  slots_stale_ = true;
  invalidate_graphs();
}

void ViewGroup::set_views(std::span<const TrainView> views, Appearance appearance, bool use_depth_limit,
                          Staging& staging, cudaStream_t stream) {
  std::vector<SceneView> scenes;
  std::vector<const std::uint8_t*> colors, albedos;
  std::vector<const float*> depths;
  for (const TrainView& view : views) {
    if (static_cast<int>(view.view.camera.width) != width || static_cast<int>(view.view.camera.height) != height) {
      throw std::invalid_argument("TrainStep: all views of a group have one size");
    }
    scenes.push_back(view.view);
    colors.push_back(view.color);
    albedos.push_back(view.albedo);
    depths.push_back(view.depth);
  }
  if (checked_batch(views) != batch) throw std::invalid_argument("TrainStep: a group keeps its number of views");
  choose_objects(scenes);
  const ViewTables tables = make_view_tables(scenes, appearance, object_ids_);

  const std::size_t pointers = aligned(views.size() * sizeof(void*));
  color_offset_ = aligned(tables.views.size() * sizeof(DeviceView));
  albedo_offset_ = color_offset_ + pointers;
  depth_offset_ = albedo_offset_ + pointers;
  object_offset_ = depth_offset_ + pointers;
  host_tables_.resize(object_offset_ + tables.object_views.size() * sizeof(ObjectView));
  const auto put = [&](std::size_t offset, const auto& values) {
    std::memcpy(host_tables_.data() + offset, values.data(), values.size() * sizeof(values[0]));
  };
  put(0, tables.views);
  put(color_offset_, colors);
  put(albedo_offset_, albedos);
  put(depth_offset_, depths);
  put(object_offset_, tables.object_views);
  const std::byte* const before = tables_.data();
  tables_.resize(host_tables_.size());
  staging.copy(tables_.data(), host_tables_, stream);
  const Targets targets(views);
  if (tables_.data() != before || targets != targets_) invalidate_graphs();
  targets_ = targets;

  if (use_depth_limit || !renewed) {
    // Nothing is known to be hidden before the first blend: all ones is a NaN, which no depth lies beyond.
    device::check(cudaMemsetAsync(patch_depth_limit_.data(), 0xFF, sizeof(float) * patch_depth_limit_.size(), stream),
                  "setting depth limits");
  }
  lists_built = false;
}

void ViewGroup::follow_model(const DeviceGaussians& gaussians, Staging& staging, cudaStream_t stream) {
  if (!slots_stale_) return;
  const auto room = static_cast<std::size_t>(std::max<std::int64_t>(gaussians.stride, 1));
  listed_.resize(room);
  slotted_ = !object_ids_.empty() && gaussians.object_id != nullptr;
  if (slotted_) {
    object_slot_.resize(room);
    device_object_ids_.resize(object_ids_.size());
    staging.copy(device_object_ids_.data(), std::as_bytes(std::span(object_ids_)), stream);
    launch_object_slots(gaussians.object_id, gaussians.count, device_object_ids_.data(),
                        static_cast<int>(object_ids_.size()), object_slot_.data(), stream);
  }
  slots_stale_ = false;
}

void ViewGroup::model_changed(int count, int count_before) {
  slots_stale_ = true;
  lists_built = false;
  invalidate_graphs();
  // Many more Gaussians may lie anywhere; a few take what room there is.
  if (count > count_before + count_before / 16) sized = false;
}

void ViewGroup::invalidate_graphs() {
  rebuild_graph.invalidate();
  reuse_graph.invalidate();
}

void ViewGroup::bind(WorkspaceView& w) const {
  w.views = at<DeviceView>(0);
  w.object_views = at<ObjectView>(object_offset_);
  w.object_count = 1 + static_cast<int>(object_ids_.size());
  w.object_slot = slotted_ ? object_slot_.data() : nullptr;
  w.tile_range = tile_range_.data();
  w.patch_depth_limit = patch_depth_limit_.data();
  if (keeps_entries_) w.pair_entries[1] = entries_.data();
  w.listed = listed_.data();
  w.loss = figures_.data()->loss;
  w.pair_count = &figures_.data()->pairs;
}

void ViewGroup::set_capacity(std::uint32_t pairs) {
  const std::uint64_t wanted = std::uint64_t{pairs} + pairs / (renewed ? 2 : 8) + 1024;
  pair_capacity = static_cast<std::uint32_t>(std::min<std::uint64_t>(wanted, kMostPairs));
  most_pairs_ = 0;
  builds_ = 0;
  invalidate_graphs();
}

void ViewGroup::size_by(std::uint32_t pairs) {
  if (!sized || pairs > pair_capacity) set_capacity(pairs);
  sized = true;
}

void ViewGroup::note_pairs(std::uint32_t pairs) {
  if (pairs > pair_capacity - pair_capacity / 32) {
    if (pairs > pair_capacity) lists_built = false;
    return set_capacity(pairs);
  }
  most_pairs_ = std::max(most_pairs_, pairs);
  if (++builds_ < kBuildsToShrink) return;
  if (most_pairs_ < pair_capacity / 2) return set_capacity(most_pairs_);
  most_pairs_ = 0;
  builds_ = 0;
}

void ViewGroup::forget_size() {
  pair_capacity = kFirstPairs;
  sized = false;
  lists_built = false;
  invalidate_graphs();
}

void ViewGroup::keep_entries(cudaStream_t stream) {
  keeps_entries_ = true;
  const std::size_t entries = std::size_t{pair_capacity} + 3;
  if (entries_.size() >= entries) return;
  device::check(cudaStreamSynchronize(stream), "waiting to grow");
  entries_.resize(entries);
  lists_built = false;
  invalidate_graphs();
}

std::size_t ViewGroup::bytes() const {
  return entries_.size() * sizeof(std::uint32_t) + tile_range_.size() * sizeof(uint2) +
         patch_depth_limit_.size() * sizeof(float) + (object_slot_.size() + listed_.size()) * sizeof(std::uint16_t) +
         tables_.size() + device_object_ids_.size() * sizeof(std::uint32_t) + sizeof(StepFigures);
}

}  // namespace splatbus::raster::cuda
