#include <algorithm>
#include <cassert>
#include <iterator>
#include <stdexcept>
#include <string>

#include "raster/cuda/kernels.h"

namespace splatbus::raster::cuda {
namespace {

constexpr std::size_t kLanes = 32;

std::string described(const WorkspaceRequest& r) {
  return std::to_string(r.batch) + " pictures of " + std::to_string(r.width) + " x " + std::to_string(r.height) +
         " pixels, " + std::to_string(r.count) + " Gaussians and " + std::to_string(r.pair_capacity) +
         " of their pairs with tiles";
}

std::string mebibytes(std::size_t bytes) {
  return std::to_string(bytes >> 20U) + " MiB";
}

void check_pixels(const WorkspaceRequest& r) {
  const auto width = static_cast<std::uint32_t>(r.width), height = static_cast<std::uint32_t>(r.height);
  if (std::size_t{width} * height <= kMostPixels / static_cast<std::size_t>(r.batch)) return;
  throw StepTooLarge("CUDA rasteriser: " + described(r) + " are more than " + std::to_string(kMostPixels) +
                     " pixels at once");
}

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
  depth_pixels = r.depth ? pixels : 0;
  training_records = r.training ? records : 0;
  training_pixels = r.training ? pixels : 0;
  training_albedo_pixels = r.training ? albedo_pixels : 0;
  training_depth_pixels = r.training ? depth_pixels : 0;
  depth_records = r.depth ? training_records : 0;
  objects = static_cast<std::size_t>(r.object_count);
  // A pair reaches at most every patch of its tile; what is left over lies in the patches' first segments.
  segments = r.training ? std::max<std::size_t>(pairs * kPatches / (kLanes * kSegmentGroups), 1) : 0;
  extra_segments = r.albedo || r.depth ? segments : 0;
}

bool Workspace::Sizes::hold(const Sizes& o) const {
  return o.count <= count && o.records <= records && o.training_records <= training_records && o.tiles <= tiles &&
         o.pairs <= pairs && o.list_pairs <= list_pairs && o.pixels <= pixels && o.albedo_pixels <= albedo_pixels &&
         o.training_pixels <= training_pixels && o.training_albedo_pixels <= training_albedo_pixels &&
         o.depth_pixels <= depth_pixels && o.training_depth_pixels <= training_depth_pixels &&
         o.depth_records <= depth_records && o.objects <= objects && o.segments <= segments &&
         o.extra_segments <= extra_segments;
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
  extra_segments = std::max(extra_segments, o.extra_segments);
  depth_pixels = std::max(depth_pixels, o.depth_pixels);
  training_depth_pixels = std::max(training_depth_pixels, o.training_depth_pixels);
  depth_records = std::max(depth_records, o.depth_records);
}

template <class Take>
void Workspace::for_each_array(WorkspaceView& m, const Sizes& s, Take take) {
  take(m.record_shape, 2 * s.records);
  take(m.record_tail, s.records);
  take(m.pair_keys[0], 2 * s.pairs);
  take(m.pair_entries[0], s.pairs);
  take(m.pair_entries[1], s.list_pairs > 0 ? s.list_pairs + 3 : 0);  // read four at a time
  take(m.listed, s.count);
  take(m.pair_count, 1);
  take(m.tile_range, s.tiles);
  take(m.patch_depth_limit, s.tiles * kPatches);
  char* scratch = nullptr;
  m.sort_scratch_bytes = sort_scratch_bytes(static_cast<std::uint32_t>(s.pairs));
  take(scratch, m.sort_scratch_bytes);
  m.sort_scratch = scratch;
  take(m.color, 3 * s.pixels);
  take(m.transmittance, s.pixels);
  take(m.albedo, 3 * s.albedo_pixels);
  take(m.depth, s.depth_pixels);
  take(m.record_gradient, s.training_records * kGradientFloats);
  take(m.record_touched, s.training_records);
  take(m.record_depth_gradient, s.depth_records);
  take(m.color_gradient, 3 * s.training_pixels);
  take(m.albedo_gradient, 3 * s.training_albedo_pixels);
  take(m.depth_gradient, s.training_depth_pixels);
  take(m.alpha_gradient, s.training_depth_pixels);
  take(m.ssim_partials, 9 * s.training_pixels);
  take(m.segments, s.segments);
  take(m.segment_extra, kLanes * s.extra_segments);
  take(m.segment_count, 1);
  take(m.loss, kMaxBatch);
  take(m.views, kMaxBatch);
  take(m.object_views, kMaxBatch * s.objects);
  take(m.object_slot, s.count);
}

void Workspace::allocate_all() {
  WorkspaceView& m = memory_;
  const Sizes& s = sizes_;
  for_each_array(m, s, [&]<class T>(T*& pointer, std::size_t elements) {
    if (elements == 0) return;
    assert(block_count_ < std::ssize(blocks_));
    void* block = nullptr;
    check(cudaMalloc(&block, elements * sizeof(T)), "allocating the workspace");
    blocks_[block_count_++] = block;
    bytes_ += elements * sizeof(T);
    pointer = static_cast<T*>(block);
  });
  m.pair_keys[1] = m.pair_keys[0] + s.pairs;
  static_assert(kPatches * sizeof(float4) <= 2 * sizeof(std::uint64_t) * kSegmentGroups);
  m.segment_color = reinterpret_cast<float4*>(m.pair_keys[0]);
  m.segment_capacity = static_cast<std::uint32_t>(s.segments);
  if (s.training_records == 0) return;
  check(cudaMemset(m.record_gradient, 0, s.training_records * kGradientFloats * sizeof(float)),
        "clearing the workspace");
  check(cudaMemset(m.record_touched, 0, s.training_records), "clearing the workspace");
  if (s.depth_records > 0) {
    check(cudaMemset(m.record_depth_gradient, 0, s.depth_records * sizeof(float)), "clearing the workspace");
  }
  // The stages run on streams that do not wait for this one.
  check(cudaDeviceSynchronize(), "clearing the workspace");
}

Workspace::Sizes Workspace::sizes_for(const WorkspaceRequest& r) const {
  Sizes grown = sizes_;
  grown.grow_to(Sizes(r));
  return grown;
}

void Workspace::require(const WorkspaceRequest& r) const {
  check_pixels(r);
  if (!sizes_.hold(Sizes(r))) require(sizes_for(r), r);
}

void Workspace::require(const Sizes& grown, const WorkspaceRequest& r) const {
  std::size_t wanted = 0, free = 0, total = 0;
  WorkspaceView unused;
  for_each_array(unused, grown, [&]<class T>(T*&, std::size_t elements) { wanted += elements * sizeof(T); });
  check(cudaMemGetInfo(&free, &total), "asking for free memory");
  // What is held is given back before.
  const std::size_t there = bytes_ + free;
  if (wanted + kMemoryLeftFree > there) {
    throw StepTooLarge("CUDA rasteriser: " + described(r) + " take " + mebibytes(wanted) + " of device memory, of " +
                       mebibytes(there) + " there are, where " + mebibytes(kMemoryLeftFree) + " are left free");
  }
}

bool Workspace::reserve(const WorkspaceRequest& r) {
  if (static_cast<std::uint32_t>(r.count) > kGaussianMask) {
    throw std::invalid_argument("CUDA rasteriser: more than 2^24 Gaussians");
  }
  check_pixels(r);
  const bool fits = block_count_ > 0 && sizes_.hold(Sizes(r));
  if (!fits) {
    const Sizes grown = sizes_for(r);
    require(grown, r);
    release();
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
  if (!r.depth) view_.depth = view_.depth_gradient = view_.alpha_gradient = view_.record_depth_gradient = nullptr;
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
