#include <algorithm>
#include <stdexcept>
#include <string>

#include "raster/cuda/kernels.h"

namespace splatbus::raster::cuda {
namespace {

constexpr std::size_t kLanes = 32;

}  // namespace

Workspace::~Workspace() {
  release();
}

void Workspace::release() {
  for (int k = 0; k < block_count_; ++k) cudaFree(blocks_[k]);
  block_count_ = 0;
  bytes_ = 0;
  memory_ = view_ = {};
}

template <class T>
void Workspace::allocate(T*& pointer, std::size_t elements) {
  if (elements == 0) return;
  void* block = nullptr;
  const std::size_t bytes = elements * sizeof(T);
  check(cudaMalloc(&block, bytes), "allocating the workspace");
  blocks_[block_count_++] = block;
  bytes_ += bytes;
  pointer = static_cast<T*>(block);
}

Workspace::Sizes::Sizes(const WorkspaceRequest& r) {
  const auto batch = static_cast<std::size_t>(r.batch);
  count = static_cast<std::size_t>(std::max({1, r.count, r.capacity}));
  records = count * batch;
  tiles = static_cast<std::size_t>((r.width + kTileSize - 1) / kTileSize) *
          static_cast<std::size_t>((r.height + kTileSize - 1) / kTileSize) * batch;
  tiles = std::max<std::size_t>(tiles, 1);
  pairs = (std::max<std::size_t>(r.pair_capacity, kLanes) + 1) / 2 * 2;
  list_pairs = r.lists ? pairs : 0;
  pixels = std::max<std::size_t>(static_cast<std::size_t>(r.width) * static_cast<std::size_t>(r.height) * batch, 1);
  albedo_pixels = r.albedo ? pixels : 0;
  training_records = r.training ? records : 0;
  training_pixels = r.training ? pixels : 0;
  training_albedo_pixels = r.training ? albedo_pixels : 0;
  objects = static_cast<std::size_t>(r.object_count);
  // A pair reaches at most every patch of its tile; what is left over lies in the patches' first segments.
  segments = r.training ? std::max<std::size_t>(pairs * kPatches / (kLanes * kSegmentGroups), 1) : 0;
  albedo_segments = r.albedo ? segments : 0;
}

bool Workspace::Sizes::hold(const Sizes& o) const {
  return o.count <= count && o.records <= records && o.training_records <= training_records && o.tiles <= tiles &&
         o.pairs <= pairs && o.list_pairs <= list_pairs && o.pixels <= pixels && o.albedo_pixels <= albedo_pixels &&
         o.training_pixels <= training_pixels && o.training_albedo_pixels <= training_albedo_pixels &&
         o.objects <= objects && o.segments <= segments && o.albedo_segments <= albedo_segments;
}

void Workspace::Sizes::grow_to(const Sizes& o) {
  count = std::max(count, o.count);
  records = std::max(records, o.records);
  training_records = std::max(training_records, o.training_records);
  tiles = std::max(tiles, o.tiles);
  pairs = std::max(pairs, o.pairs);
  list_pairs = std::max(list_pairs, o.list_pairs);
  pixels = std::max(pixels, o.pixels);
  albedo_pixels = std::max(albedo_pixels, o.albedo_pixels);
  training_pixels = std::max(training_pixels, o.training_pixels);
  training_albedo_pixels = std::max(training_albedo_pixels, o.training_albedo_pixels);
  objects = std::max(objects, o.objects);
  segments = std::max(segments, o.segments);
  albedo_segments = std::max(albedo_segments, o.albedo_segments);
}

void Workspace::allocate_all() {
  WorkspaceView& m = memory_;
  const Sizes& s = sizes_;
  allocate(m.record_shape, 2 * s.records);
  allocate(m.record_tail, s.records);
  allocate(m.pair_keys[0], 2 * s.pairs);
  m.pair_keys[1] = m.pair_keys[0] + s.pairs;
  allocate(m.pair_entries[0], s.pairs);
  allocate(m.pair_entries[1], s.list_pairs > 0 ? s.list_pairs + 3 : 0);  // read four at a time
  allocate(m.listed, s.count);
  allocate(m.pair_count, 1);
  allocate(m.tile_range, s.tiles);
  allocate(m.patch_depth_limit, s.tiles * kPatches);
  m.sort_scratch_bytes = sort_scratch_bytes(static_cast<std::uint32_t>(s.pairs));
  char* scratch = nullptr;
  allocate(scratch, m.sort_scratch_bytes);
  m.sort_scratch = scratch;
  allocate(m.color, 3 * s.pixels);
  allocate(m.transmittance, s.pixels);
  allocate(m.albedo, 3 * s.albedo_pixels);
  allocate(m.record_gradient, s.training_records * kGradientFloats);
  allocate(m.record_touched, s.training_records);
  if (s.training_records > 0) {
    check(cudaMemset(m.record_gradient, 0, s.training_records * kGradientFloats * sizeof(float)),
          "clearing the workspace");
    check(cudaMemset(m.record_touched, 0, s.training_records), "clearing the workspace");
    // The stages run on streams that do not wait for this one.
    check(cudaDeviceSynchronize(), "clearing the workspace");
  }
  allocate(m.color_gradient, 3 * s.training_pixels);
  allocate(m.albedo_gradient, 3 * s.training_albedo_pixels);
  allocate(m.ssim_partials, 9 * s.training_pixels);
  allocate(m.segments, s.segments);
  static_assert(kPatches * sizeof(float4) <= 2 * sizeof(std::uint64_t) * kSegmentGroups);
  m.segment_color = reinterpret_cast<float4*>(m.pair_keys[0]);
  allocate(m.segment_albedo, kLanes * s.albedo_segments);
  allocate(m.segment_count, 1);
  m.segment_capacity = static_cast<std::uint32_t>(s.segments);
  allocate(m.loss, kMaxBatch);
  allocate(m.views, kMaxBatch);
  allocate(m.object_views, kMaxBatch * s.objects);
  allocate(m.object_slot, s.count);
}

bool Workspace::reserve(const WorkspaceRequest& r) {
  if (static_cast<std::uint32_t>(r.count) > kGaussianMask) {
    throw std::invalid_argument("CUDA rasteriser: more than 2^24 Gaussians");
  }
  const Sizes needed(r);
  const bool fits = block_count_ > 0 && sizes_.hold(needed);
  if (!fits) {
    release();
    Sizes grown = sizes_;
    grown.grow_to(needed);
    sizes_ = grown;
    try {
      allocate_all();
    } catch (...) {
      release();
      sizes_ = {};
      throw;
    }
  }
  view_ = memory_;
  if (!r.albedo) view_.albedo = view_.albedo_gradient = nullptr;
  if (!r.training) view_.segments = nullptr;
  if (!r.lists) view_.pair_entries[1] = nullptr;
  view_.count = r.count;
  view_.batch = r.batch;
  view_.object_count = r.object_count;
  view_.width = r.width;
  view_.height = r.height;
  view_.tiles_x = (r.width + kTileSize - 1) / kTileSize;
  view_.tiles_y = (r.height + kTileSize - 1) / kTileSize;
  view_.pair_capacity = r.pair_capacity;
  return !fits;
}

}  // namespace splatbus::raster::cuda
