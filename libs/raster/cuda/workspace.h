#pragma once

#include <cuda_runtime.h>

#include <cstddef>
#include <cstdint>

#include "raster/cuda/device_scene.h"

namespace splatbus::raster::cuda {

/// Device memory of the kernels, all of it allocated by Workspace::reserve and owned by it. `batch * count` records,
/// one a view and Gaussian: record = view * count + Gaussian.
struct WorkspaceView {
  int count = 0, batch = 0, width = 0, height = 0;
  int tiles_x = 0, tiles_y = 0;
  std::uint32_t pair_capacity = 0;

  // Projected Gaussians. Powers are premultiplied so that alpha = opacity * 2^(a dx^2 + b dx dy + c dy^2).
  float4* record_geometry = nullptr;  ///< x, y (pixels), a, b
  float4* record_shading = nullptr;   ///< c, opacity (0: culled), red, green
  float2* record_tail = nullptr;      ///< blue, depth (metres)
  float* record_gradient = nullptr;   ///< [batch * count][kGradientFloats]

  float* direction_gradient =
      nullptr;  ///< [3 colours][3][count]: what view-dependent colour adds to the mean's gradient

  // (tile, Gaussian) pairs, sorted by view, tile and depth.
  std::uint64_t* pair_keys[2] = {nullptr, nullptr};
  std::uint32_t* pair_records[2] = {nullptr, nullptr};
  std::uint32_t* pair_count = nullptr;  ///< pairs that the last build wanted; above pair_capacity the rest is missing
  uint2* tile_range = nullptr;          ///< [batch * tiles], into the sorted pairs
  float* tile_depth_limit = nullptr;  ///< [batch * tiles], depth beyond which every pixel was opaque at the last blend
  void* sort_scratch = nullptr;
  std::size_t sort_scratch_bytes = 0;

  // Pictures, [batch][channel][height][width].
  float* color = nullptr;
  float* albedo = nullptr;
  float* transmittance = nullptr;  ///< [batch][height][width]
  float* color_gradient = nullptr;
  float* albedo_gradient = nullptr;
  float* ssim_partials = nullptr;  ///< [3][batch][3][height][width]
  float* loss = nullptr;           ///< [batch]

  // Small tables, written before a step.
  DeviceView* views = nullptr;           ///< [kMaxBatch]
  ObjectView* object_views = nullptr;    ///< [kMaxBatch][object_count]
  std::uint16_t* object_slot = nullptr;  ///< [count], row of object_views; null: all 0
  int object_count = 1;
};

constexpr int kGradientFloats = 12;  // x, y, a, b, c, opacity, red, green, blue, albedo

struct WorkspaceRequest {
  int count = 0, batch = 1, width = 0, height = 0;
  int object_count = 1;
  bool albedo = false;
  bool training = true;
  std::uint32_t pair_capacity = 0;
};

/// Owner of a WorkspaceView's memory. Throws std::runtime_error naming the CUDA error.
class Workspace {
 public:
  Workspace() = default;
  ~Workspace();
  Workspace(const Workspace&) = delete;
  Workspace& operator=(const Workspace&) = delete;

  /// Grows to hold what is asked for; contents are lost when anything grows. True when pointers changed.
  bool reserve(const WorkspaceRequest& request);
  [[nodiscard]] const WorkspaceView& view() const { return view_; }
  [[nodiscard]] std::size_t bytes() const { return bytes_; }

 private:
  void release();
  template <class T>
  void allocate(T*& pointer, std::size_t elements);
  WorkspaceView view_;
  WorkspaceRequest request_;
  std::size_t bytes_ = 0;
  void* blocks_[32] = {};
  int block_count_ = 0;
};

/// Throws std::runtime_error with `what` and the error's name.
void check(cudaError_t status, const char* what);

}  // namespace splatbus::raster::cuda
