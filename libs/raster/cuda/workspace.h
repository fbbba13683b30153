#pragma once

#include <cuda_runtime.h>

#include <cstddef>
#include <cstdint>
#include <stdexcept>

#include "device/check.h"
#include "raster/cuda/device_scene.h"

namespace splatbus::raster::cuda {

using device::check;

/// Device memory of the kernels, all of it allocated by Workspace::reserve and owned by it. `batch * count` records,
/// one a view and Gaussian: record = view * count + Gaussian.
struct WorkspaceView {
  int count = 0, batch = 0, width = 0, height = 0;
  int tiles_x = 0, tiles_y = 0;
  std::uint32_t pair_capacity = 0;

  // Projected Gaussians: alpha = 2^(log2_alpha - u^2 - v^2) with u = uxx dx + uxy dy, v = uyy dy.
  float4* record_shape = nullptr;    ///< [batch * count][2]: x, y (pixels), log2_alpha, uxx | uxy, uyy, red, green
  float2* record_tail = nullptr;     ///< blue, depth (metres); a colour that was clamped to 0 is -0
  float* record_gradient = nullptr;  ///< [batch * count][kGradientFloats]; zero but between blending and update
  float* record_depth_gradient = nullptr;  ///< [batch * count] of the depth; zero but between them, too
  std::uint8_t* record_touched = nullptr;  ///< [batch * count] blended into a pixel; zero but between them, too

  std::uint16_t* listed = nullptr;  ///< [count] bit b: in a tile's list of view b

  // (tile, Gaussian) pairs, sorted by view, tile and depth.
  std::uint64_t* pair_keys[2] = {nullptr, nullptr};     ///< SortKey
  std::uint32_t* pair_entries[2] = {nullptr, nullptr};  ///< Gaussian | patches that it may reach << kPatchShift
  std::uint32_t* pair_count = nullptr;  ///< pairs that the last build wanted; above pair_capacity the rest is missing
  uint2* tile_range = nullptr;          ///< [batch * tiles], into the sorted pairs
  float* patch_depth_limit =
      nullptr;  ///< [batch * tiles][kPatches], beyond it every pixel was opaque when last blended
  void* sort_scratch = nullptr;
  std::size_t sort_scratch_bytes = 0;

  // A patch's Gaussians are taken in segments of kSegmentGroups * 32 by the backward pass, all of them at once. The
  // first segment of each patch is known; of the others the forward pass leaves where they begin, and each pixel's
  // state there. Null without training.
  uint2* segments = nullptr;  ///< [segment_capacity], in no order: patch of the batch, position in pair_entries[1]
  float4* segment_color = nullptr;  ///< [segment_capacity][32] transmittance, red, green, blue blended so far; it lies
                                    ///< in pair_keys, which nothing reads after the sort
  float4* segment_extra = nullptr;  ///< [segment_capacity][32] albedo and depth blended so far
  std::uint32_t* segment_count = nullptr;
  std::uint32_t segment_capacity = 0;  ///< as many as there can be

  // Pictures, [batch][channel][height][width].
  float* color = nullptr;
  float* albedo = nullptr;
  float* depth = nullptr;          ///< [batch][height][width] sum of weight * z, metres
  float* transmittance = nullptr;  ///< [batch][height][width]
  float* color_gradient = nullptr;
  float* albedo_gradient = nullptr;
  float* depth_gradient = nullptr;
  float* alpha_gradient = nullptr;  ///< of alpha = 1 - transmittance
  float* ssim_partials = nullptr;   ///< [3][batch][3][height][width]
  float* loss = nullptr;            ///< [batch]

  // Small tables, written before a step.
  DeviceView* views = nullptr;           ///< [kMaxBatch]
  ObjectView* object_views = nullptr;    ///< [kMaxBatch][object_count]
  std::uint16_t* object_slot = nullptr;  ///< [count], row of object_views; null: all 0
  int object_count = 1;
};

/// With s = dL/d(ln alpha) and d the offset of a pixel from the Gaussian, sums over pixels: s dx, s dy, s dx^2, s dx
/// dy, s dy^2, s; then the gradients of red, green, blue and albedo.
constexpr int kGradientFloats = 12;
/// Groups of 32 Gaussians in a segment.
constexpr int kSegmentGroups = 8;
constexpr int kPatchShift = 24;
constexpr std::uint32_t kGaussianMask = (1U << kPatchShift) - 1;

struct WorkspaceRequest {
  int count = 0;     ///< Gaussians
  int capacity = 0;  ///< to make room for, where that is more than `count`
  int batch = 1, width = 0, height = 0;
  int object_count = 1;
  bool albedo = false;
  bool depth = false;  ///< the depth plane; in training also gradients through it and through alpha
  bool training = true;
  bool lists = true;  ///< room for sorted entries; false: the caller has its own
  std::uint32_t pair_capacity = 0;
};

/// Pixels of all pictures that are drawn at once.
constexpr std::size_t kMostPixels = std::size_t{1} << 30;
/// Of the device's memory, what a workspace leaves to others when it grows.
constexpr std::size_t kMemoryLeftFree = std::size_t{256} << 20;

/// Pictures or lists want more memory than there is to have. It is thrown before anything is allocated, so that what is
/// held stays as it is, and work that fits goes on.
class StepTooLarge : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Owner of a WorkspaceView's memory. It never shrinks, so that pictures of several sizes can take turns. Throws
/// StepTooLarge, or std::runtime_error naming the CUDA error.
class Workspace {
 public:
  Workspace() = default;
  ~Workspace();
  Workspace(const Workspace&) = delete;
  Workspace& operator=(const Workspace&) = delete;

  /// Throws StepTooLarge when reserve() would: more than kMostPixels, or memory that would not leave kMemoryLeftFree.
  void require(const WorkspaceRequest& request) const;
  /// Grows to hold what is asked for; contents are lost when anything grows. True when pointers changed.
  bool reserve(const WorkspaceRequest& request);
  [[nodiscard]] const WorkspaceView& view() const { return view_; }
  [[nodiscard]] std::size_t bytes() const { return bytes_; }

 private:
  /// What the arrays' sizes follow from.
  struct Sizes {
    std::size_t count = 0, records = 0, training_records = 0, tiles = 0, pairs = 0, list_pairs = 0;
    std::size_t pixels = 0, albedo_pixels = 0, depth_pixels = 0, objects = 0;
    std::size_t training_pixels = 0, training_albedo_pixels = 0, training_depth_pixels = 0, depth_records = 0;
    std::size_t segments = 0, extra_segments = 0;

    explicit Sizes(const WorkspaceRequest& request);
    Sizes() = default;
    [[nodiscard]] bool hold(const Sizes& other) const;
    void grow_to(const Sizes& other);
  };

  /// Calls `take(pointer, elements)` for every array.
  template <class Take>
  static void for_each_array(WorkspaceView& memory, const Sizes& sizes, Take take);
  /// Sizes to grow to; as they are when the request fits.
  [[nodiscard]] Sizes sizes_for(const WorkspaceRequest& request) const;
  void require(const Sizes& grown, const WorkspaceRequest& request) const;
  void release();
  void allocate_all();
  WorkspaceView memory_, view_;
  Sizes sizes_;
  std::size_t bytes_ = 0;
  void* blocks_[32] = {};
  int block_count_ = 0;
};

}  // namespace splatbus::raster::cuda
