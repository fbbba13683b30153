#include "raster/cuda/workspace.h"

#include <algorithm>
#include <cassert>
#include <numeric>
#include <stdexcept>
#include <string>

#include "gaussians/pages.h"
#include "raster/cuda/kernels.h"

namespace splatbus::raster::cuda {
namespace {

constexpr std::size_t kLanes = 32;

bool lists_some(const WorkspaceRequest& r) {
  return r.range_count > 0 && r.list_capacity > 0;
}

std::size_t rows_of(const WorkspaceRequest& r) {
  if (lists_some(r)) return std::size_t{r.list_capacity} * kPageLanes;
  return static_cast<std::size_t>(std::max({1, r.count, r.capacity}));
}

void check_limits(const WorkspaceRequest& r) {
  if (rows_of(r) > kRowMask) throw std::invalid_argument("CUDA rasteriser: more than 2^24 Gaussians at once");
  const auto width = static_cast<std::uint32_t>(r.width), height = static_cast<std::uint32_t>(r.height);
  if (std::size_t{width} * height > kMaxPixels / static_cast<std::size_t>(r.batch)) {
    throw std::invalid_argument("CUDA rasteriser: " + std::to_string(r.batch) + " pictures of " +
                                std::to_string(r.width) + " x " + std::to_string(r.height) + " are more than " +
                                std::to_string(kMaxPixels) + " pixels at once");
  }
}

/// Everything but pointers.
WorkspaceView shape_of(const WorkspaceRequest& r) {
  WorkspaceView w;
  w.count = r.count;
  w.rows = lists_some(r) ? static_cast<int>(rows_of(r)) : r.count;
  w.list_capacity = lists_some(r) ? r.list_capacity : static_cast<std::uint32_t>(r.range_count);
  w.batch = r.batch;
  w.width = r.width;
  w.height = r.height;
  w.tiles_x = (r.width + kTileSize - 1) / kTileSize;
  w.tiles_y = (r.height + kTileSize - 1) / kTileSize;
  w.isect_capacity = r.isect_capacity;
  w.range_count = r.range_count;
  w.object_count = std::max(r.object_count, 1);
  w.source_room = r.source_room;
  return w;
}

std::size_t isects_of(const WorkspaceRequest& r) {
  return (std::max<std::size_t>(r.isect_capacity, kLanes) + 1) / 2 * 2;
}

/// The list of arrays: calls `take(pointer, elements)` for each.
template <class Take>
void for_each_array(const WorkspaceRequest& r, WorkspaceView& w, Take take) {
  const auto batch = static_cast<std::size_t>(r.batch), objects = static_cast<std::size_t>(r.object_count);
  const auto count = static_cast<std::size_t>(std::max({1, r.count, r.capacity}));
  const auto ranges = static_cast<std::size_t>(r.range_count > 0 ? std::max(r.range_count, r.range_capacity) : 0);
  const std::size_t pixels = static_cast<std::size_t>(r.width) * static_cast<std::size_t>(r.height) * batch;
  const std::size_t tiles = static_cast<std::size_t>(w.tiles_x) * static_cast<std::size_t>(w.tiles_y) * batch;
  const std::size_t isects = isects_of(r), projected = rows_of(r) * batch, trained = r.training ? projected : 0;
  const std::size_t albedo = r.albedo ? pixels : 0, depth = r.depth ? pixels : 0, training = r.training ? 1 : 0;
  // An intersection reaches at most every patch of its tile; what is left over lies in the patches' first segments.
  const std::size_t segments = training * std::max<std::size_t>(isects * kPatches / (kLanes * kSegmentGroups), 1);
  w.segment_capacity = static_cast<std::uint32_t>(segments);
  w.sort_scratch_bytes = sort_scratch_bytes(static_cast<std::uint32_t>(isects));

  take(w.projected_shape, 2 * projected);
  take(w.projected_tail, projected);
  take(w.projected_gradient, trained * kGradientFloats);
  take(w.projected_visible, trained);
  take(w.projected_depth_gradient, r.depth ? trained : 0);
  take(w.counts, 1);
  take(w.range_marks, ranges);
  take(w.listed, ranges);
  take(w.isect_ids[0], 2 * isects);
  take(w.flatten_ids[0], isects);
  take(w.flatten_ids[1], isects + 3);  // read four at a time
  take(w.tile_offsets, tiles);
  std::byte* scratch = nullptr;
  take(scratch, w.sort_scratch_bytes);
  w.sort_scratch = scratch;
  take(w.segments, segments);
  take(w.segment_trains, training * (tiles * kPatches + segments));
  take(w.patch_end, training * tiles * kPatches);
  take(w.segment_extra, r.albedo || r.depth ? kLanes * segments : 0);
  take(w.color, 3 * pixels);
  take(w.transmittance, pixels);
  take(w.albedo, 3 * albedo);
  take(w.depth, depth);
  take(w.color_gradient, 3 * pixels * training);
  take(w.albedo_gradient, 3 * albedo * training);
  take(w.depth_gradient, depth * training);
  take(w.alpha_gradient, depth * training);
  take(w.ssim_partials, 9 * pixels * training);
  take(w.mask, r.mask ? pixels * training : 0);
  take(w.views, objects > 0 ? batch : 0);
  take(w.object_views, batch * objects);
  take(w.object_ids, objects);
  take(w.sources, batch * static_cast<std::size_t>(r.source_room));
  take(w.object_slot, r.object_slots ? count : 0);
}

}  // namespace

bool Workspace::reserve(const WorkspaceRequest& request) {
  if (memory_.size() > 0 && request == request_) return false;
  check_limits(request);
  view_ = shape_of(request);
  constexpr std::size_t kArrayAlignment = 256;
  std::size_t k = 0;
  Sizes room = room_;
  for_each_array(request, view_, [&]<class T>(T*&, std::size_t elements) {
    assert(k < kMaxArrays);
    room[k] = std::max(room[k], (elements * sizeof(T) + kArrayAlignment - 1) / kArrayAlignment * kArrayAlignment);
    ++k;
  });
  const bool grows = room != room_;
  if (grows) {
    memory_ = {};  // given back before more is taken
    memory_.resize(std::accumulate(room.begin(), room.end(), std::size_t{0}));
    room_ = room;
    // Gradients are zero before the first step. The stages run on streams that do not wait for this one.
    memory_.clear(nullptr);
    check(cudaDeviceSynchronize(), "clearing the workspace");
  }
  request_ = request;
  std::byte* at = memory_.data();
  k = 0;
  for_each_array(request, view_, [&]<class T>(T*& pointer, std::size_t elements) {
    pointer = elements > 0 ? reinterpret_cast<T*>(at) : nullptr;
    at += room_[k++];
  });
  view_.loss = view_.counts->loss;
  view_.isect_ids[1] = view_.isect_ids[0] + isects_of(request);
  static_assert(kPatches * sizeof(float4) <= 2 * sizeof(std::uint64_t) * kSegmentGroups);
  view_.segment_color = reinterpret_cast<float4*>(view_.isect_ids[0]);
  return grows;
}

}  // namespace splatbus::raster::cuda
