#include <stdexcept>
#include <string>

#include "raster/cuda/kernels.h"

namespace splatbus::raster::cuda {

Workspace::~Workspace() {
  release();
}

void Workspace::release() {
  for (int k = 0; k < block_count_; ++k) cudaFree(blocks_[k]);
  block_count_ = 0;
  bytes_ = 0;
  view_ = {};
}

template <class T>
void Workspace::allocate(T*& pointer, std::size_t elements) {
  void* block = nullptr;
  const std::size_t bytes = (elements > 0 ? elements : 1) * sizeof(T);
  check(cudaMalloc(&block, bytes), "allocating the workspace");
  blocks_[block_count_++] = block;
  bytes_ += bytes;
  pointer = static_cast<T*>(block);
}

bool Workspace::reserve(const WorkspaceRequest& r) {
  if (static_cast<std::uint32_t>(r.count) > kGaussianMask) {
    throw std::invalid_argument("CUDA rasteriser: more than 2^24 Gaussians");
  }
  const bool fits = r.count <= request_.count && r.batch <= request_.batch && r.object_count <= request_.object_count &&
                    r.albedo == request_.albedo && r.lists == request_.lists && r.training <= request_.training &&
                    r.width == request_.width && r.height == request_.height &&
                    r.pair_capacity <= request_.pair_capacity && block_count_ > 0;
  if (!fits) {
    release();
    request_ = r;
    const std::size_t records = static_cast<std::size_t>(r.count) * r.batch;
    const std::size_t pixels = static_cast<std::size_t>(r.width) * r.height * r.batch;
    const std::size_t tiles = static_cast<std::size_t>((r.width + kTileSize - 1) / kTileSize) *
                              ((r.height + kTileSize - 1) / kTileSize) * r.batch;
    allocate(view_.record_shape, 2 * records);
    allocate(view_.record_tail, records);
    for (int k = 0; k < 2; ++k) allocate(view_.pair_keys[k], r.pair_capacity);
    allocate(view_.pair_entries[0], r.pair_capacity);
    if (r.lists) allocate(view_.pair_entries[1], r.pair_capacity + 3);  // read four at a time
    allocate(view_.listed, r.count);
    allocate(view_.pair_count, 1);
    allocate(view_.tile_range, tiles);
    allocate(view_.patch_depth_limit, tiles * kPatches);
    view_.sort_scratch_bytes = sort_scratch_bytes(r.pair_capacity);
    char* scratch = nullptr;
    allocate(scratch, view_.sort_scratch_bytes);
    view_.sort_scratch = scratch;
    allocate(view_.color, 3 * pixels);
    allocate(view_.transmittance, pixels);
    if (r.albedo) allocate(view_.albedo, 3 * pixels);
    if (r.training) {
      allocate(view_.record_gradient, records * kGradientFloats);
      allocate(view_.record_touched, records);
      check(cudaMemset(view_.record_gradient, 0, records * kGradientFloats * sizeof(float)), "clearing the workspace");
      check(cudaMemset(view_.record_touched, 0, records), "clearing the workspace");
      // The stages run on streams that do not wait for this one.
      check(cudaDeviceSynchronize(), "clearing the workspace");
      allocate(view_.color_gradient, 3 * pixels);
      if (r.albedo) allocate(view_.albedo_gradient, 3 * pixels);
      allocate(view_.ssim_partials, 9 * pixels);
    }
    allocate(view_.loss, kMaxBatch);
    allocate(view_.views, kMaxBatch);
    allocate(view_.object_views, static_cast<std::size_t>(kMaxBatch) * r.object_count);
    allocate(view_.object_slot, r.count);
  }
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
