#pragma once

#include <cuda_runtime.h>

#include <array>
#include <cstddef>
#include <cstdint>

#include "device/buffer.h"
#include "device/check.h"
#include "raster/cuda/device_scene.h"

namespace splatbus::raster::cuda {

using device::check;

/// What a step leaves for the host to read.
struct StepCounts {
  float loss[kMaxBatch];
  std::uint32_t isects;     ///< intersections that there are; above isect_capacity the rest is missing
  std::uint32_t segments;   ///< in `segments`
  std::uint32_t listed;     ///< ranges in `listed`
  std::uint32_t seen;       ///< ranges that some view may see; above list_capacity the rest is not listed
  std::uint32_t masked;     ///< pixels that only mask_unmodelled masks
  std::uint32_t far_field;  ///< ranges in `listed` that are the far field's
};

/// Gaussians of a model in pages that some view may see.
struct ListedRange {
  std::uint32_t first;
  std::uint32_t count : 31;
  std::uint32_t frozen : 1;  ///< IndexRange's
  std::uint32_t range;       ///< index into DeviceGaussians::ranges
  std::uint32_t mark;        ///< slot, the row of object_views, << 16 | views; bit b: view b may see it
};

/// Device memory of the kernels. `batch * rows` projected Gaussians, that of view v and row r at v * rows + r. The row
/// of a Gaussian is its index or, of a model with ranges, where it lies among those that are listed: kPageLanes rows
/// each, so that what no view sees takes no memory.
struct WorkspaceView {
  int count = 0, rows = 0, batch = 0, width = 0, height = 0;
  int tiles_x = 0, tiles_y = 0;
  std::uint32_t isect_capacity = 0;

  // Of a model with ranges; else null. Gaussians that are not listed are not projected.
  int range_count = 0;
  std::uint32_t list_capacity = 0;
  std::uint32_t* range_marks = nullptr;  ///< [range_count] slot << 16 | views
  ListedRange* listed = nullptr;         ///< [counts->listed], ascending

  // Projected Gaussians: alpha = 2^(log2_alpha - u^2 - v^2) with u = uxx dx + uxy dy, v = uyy dy. Of a frozen range
  // uxx, and with it uxy, is negative: u changes its sign, and the picture not a bit.
  float4* projected_shape = nullptr;    ///< [batch * rows][2]: x, y (pixels), log2_alpha, uxx | uxy, uyy, red, green
  float2* projected_tail = nullptr;     ///< blue, depth (metres); a colour that was clamped to 0 is -0
  float* projected_gradient = nullptr;  ///< [batch * rows][kGradientFloats]; zero but between blending and update
  float* projected_depth_gradient = nullptr;  ///< [batch * rows] of the depth; zero but between them, too
  std::uint8_t* projected_visible =
      nullptr;  ///< [batch * rows] blended into a pixel, and not frozen; zero but between them, too

  StepCounts* counts = nullptr;  ///< cleared before every projection

  // Intersections of Gaussians with tiles; [1] is sorted by view, tile and depth.
  std::uint64_t* isect_ids[2] = {nullptr, nullptr};    ///< SortKey
  std::uint32_t* flatten_ids[2] = {nullptr, nullptr};  ///< row | patches that it may reach << kPatchShift
  uint2* tile_offsets = nullptr;                       ///< [batch * tiles], begin and end of its intersections
  void* sort_scratch = nullptr;
  std::size_t sort_scratch_bytes = 0;

  // A patch's Gaussians are taken in segments of kSegmentGroups * 32 by the backward pass, all of them at once. The
  // first segment of each patch is known; of the others the forward pass leaves where they begin, and each pixel's
  // state there. Null without training.
  uint2* segments = nullptr;        ///< [segment_capacity], in no order: patch of the batch, position in flatten_ids[1]
  float4* segment_color = nullptr;  ///< [segment_capacity][32] transmittance, red, green, blue blended so far; it lies
                                    ///< in isect_ids, which nothing reads after the sort
  float4* segment_extra = nullptr;  ///< [segment_capacity][32] albedo and depth blended so far
  std::uint32_t segment_capacity = 0;  ///< as many as there can be
  /// [batch * tiles * kPatches + segment_capacity] of the patches' first segments, then of the others: 1 where one of
  /// its Gaussians trains. The backward pass leaves out the others; null: it takes all.
  std::uint8_t* segment_trains = nullptr;
  /// [batch * tiles * kPatches] position in flatten_ids[1] behind what a patch needed to become opaque, to within 32
  /// of its Gaussians; null: nobody wants to know.
  std::uint32_t* patch_end = nullptr;

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
  std::uint8_t* mask = nullptr;     ///< [batch][height][width] what launch_mask_unmodelled() makes
  float* loss = nullptr;            ///< [batch], in `counts` but for those who only want a loss

  // Small tables, written before a step.
  DeviceView* views = nullptr;           ///< [kMaxBatch]
  ObjectView* object_views = nullptr;    ///< [kMaxBatch][object_count]
  std::uint32_t* object_ids = nullptr;   ///< [object_count - 1], ascending, of the rows behind the first
  std::uint16_t* object_slot = nullptr;  ///< [count], row of object_views or kHiddenSlot; null: as the range says, or 0
  ShadingSource* sources = nullptr;      ///< [kMaxBatch][source_room], the views' light sources; null: none
  int object_count = 1;
  int source_room = 0;  ///< 0: kernels are those that know no sources
  /// Of the far field; -1: there is none. Its Gaussians learn nothing from a view with depth that shows no sky where
  /// their middle is (RenderGradient::surface_depth).
  int far_slot = -1;
  const float* const* surface_depths = nullptr;  ///< [batch], null for a view that has none; null: no view has one
};

/// With s = dL/d(ln alpha) and d the offset of a pixel from the Gaussian, sums over pixels: s dx, s dy, s dx^2, s dx
/// dy, s dy^2, s; then the gradients of red, green, blue and albedo.
constexpr int kGradientFloats = 12;
/// Groups of 32 Gaussians in a segment.
constexpr int kSegmentGroups = 8;
constexpr int kPatchShift = 24;
constexpr std::uint32_t kRowMask = (1U << kPatchShift) - 1;

/// What a workspace has to hold.
struct WorkspaceRequest {
  int count = 0;     ///< Gaussians
  int capacity = 0;  ///< to make room for, where that is more than `count`
  int batch = 1, width = 0, height = 0;
  int range_count = 0, range_capacity = 0;  ///< as count and capacity
  std::uint32_t list_capacity = 0;          ///< ranges that may be listed at once; 0: all
  int object_count = 0;  ///< rows of object_views; 0: the caller brings views, object_views, object_ids and object_slot
  int source_room = 0;   ///< with object_count
  bool object_slots = false;  ///< room for object_slot, with object_count
  bool albedo = false;
  bool depth = false;  ///< the depth plane; in training also gradients through it and through alpha
  bool training = true;
  bool mask = false;  ///< in training
  std::uint32_t isect_capacity = 0;

  bool operator==(const WorkspaceRequest&) const = default;
};

/// Pixels of all pictures that are drawn at once.
constexpr std::size_t kMaxPixels = std::size_t{1} << 30;

/// Owner of a WorkspaceView's memory. It never shrinks, so that pictures of several sizes can take turns. Throws
/// std::invalid_argument for more than kMaxPixels or 2^24 rows, std::runtime_error naming the CUDA error.
class Workspace {
 public:
  /// Makes view() one for what is asked for; arrays that it does not need are null. True when it had to grow: contents
  /// are lost then, and earlier views no longer count.
  bool reserve(const WorkspaceRequest& request);
  [[nodiscard]] const WorkspaceView& view() const { return view_; }
  [[nodiscard]] std::size_t bytes() const { return memory_.size(); }

 private:
  static constexpr std::size_t kMaxArrays = 32;
  using Sizes = std::array<std::size_t, kMaxArrays>;  ///< bytes of each array

  WorkspaceRequest request_;
  WorkspaceView view_;
  Sizes room_{};
  device::Buffer<std::byte> memory_;
};

}  // namespace splatbus::raster::cuda
