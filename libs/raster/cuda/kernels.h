#pragma once

#include <cuda_runtime.h>

#include "raster/cuda/workspace.h"

// The stages of a step, each a few launches on `stream`, with no synchronisation and no allocation, so that a step can
// be captured in a graph. All pointers are device pointers unless a name says host.
namespace splatbus::raster::cuda {

struct ProjectOptions {
  float blur_px2 = 0.3F;
  bool antialias = true;
};

/// Copies `bytes`, a multiple of 16, from slot `turn % slots` of `ring`, pinned host memory, to `tables`, and adds 1 to
/// `turn`, a device word: a launch that stays the same, in a graph too, while the host fills the slots in turn. Clears
/// `counts`.
void launch_copy_tables(const std::byte* ring, int slots, std::byte* tables, std::size_t bytes, std::uint32_t* turn,
                        StepCounts* counts, cudaStream_t stream);

void launch_clear_counts(const WorkspaceView& workspace, cudaStream_t stream);

/// [count] rows of object_views: 0 for the world's frame, else 1 + the index of a Gaussian's object in the ascending
/// `object_ids`, kHiddenSlot when it is none of them. `gaussians` has object_id.
void launch_object_slots(const DeviceGaussians& gaussians, const std::uint32_t* object_ids, int id_count,
                         std::uint16_t* slots, cudaStream_t stream);

/// Lists the ranges that any view sees, as select_ranges() does, in their order; all whose object a view has, where
/// bounds are unknown. Nothing without ranges.
void launch_list_ranges(const DeviceGaussians& gaussians, const WorkspaceView& workspace, float blur_px2,
                        cudaStream_t stream);

/// Makes the bounds of the listed ranges true again. Nothing without bounds.
void launch_bounds(const DeviceGaussians& gaussians, const WorkspaceView& workspace, cudaStream_t stream);

/// Lists the ranges, projects and shades their Gaussians for the views that see them (all for every view, without
/// ranges); fills projected_shape and projected_tail, and lists which tiles they meet, unsorted. The caller has cleared
/// the counts.
void launch_project(const DeviceGaussians& gaussians, const WorkspaceView& workspace, const ProjectOptions& options,
                    cudaStream_t stream);

/// Sorts the intersections and finds those of each tile.
void launch_sort(const WorkspaceView& workspace, cudaStream_t stream);

/// Scratch that launch_sort needs.
[[nodiscard]] std::size_t sort_scratch_bytes(std::uint32_t isect_capacity);

/// Blends front to back. Writes color, transmittance and, when they are there, albedo and depth.
void launch_blend_forward(const DeviceGaussians& gaussians, const WorkspaceView& workspace, cudaStream_t stream);

/// Largest blending weight of each Gaussian in any pixel of one view, [count], which the caller has cleared: what
/// launch_blend_forward blends, without the picture.
void launch_contribution(const DeviceGaussians& gaussians, const WorkspaceView& workspace, int view,
                         float* contribution, cudaStream_t stream);

/// Adds to projected_gradient and projected_depth_gradient what the pictures' gradients imply (of albedo, alpha and
/// depth where there are any; depth's only with alpha's), and marks projected_visible. Nothing happens when
/// intersections are missing, so that a step whose lists did not fit changes no Gaussian.
void launch_blend_backward(const DeviceGaussians& gaussians, const WorkspaceView& workspace, cudaStream_t stream);

/// Of a step's views, as in raster::LossOptions.
struct ViewMasks {
  const std::uint8_t* const* of_views = nullptr;  ///< device array of [h][w] each, or null; null: none has any
  const std::uint8_t* plane = nullptr;            ///< [batch][h][w], which counts instead

  /// Null: nothing is masked.
  [[nodiscard]] SPLATBUS_PORTABLE_MEMBER const std::uint8_t* of(int view, std::size_t pixels) const {
    if (plane != nullptr) return plane + static_cast<std::size_t>(view) * pixels;
    return of_views == nullptr ? nullptr : of_views[view];
  }
};

/// Makes workspace.mask of the views' own `masks`, as in ViewMasks, and of what nothing models yet
/// (raster/unmodelled.h, with `opacity`; `far_field`: some view may have one), and counts the latter in counts->masked.
/// `depths`: device array of [h][w] each, or null for a view that has none. Behind launch_blend_forward().
void launch_mask_unmodelled(const float* const* depths, const std::uint8_t* const* masks, float opacity, bool far_field,
                            const WorkspaceView& workspace, cudaStream_t stream);

struct LossKernelOptions {
  ViewMasks masks;
  float ssim_weight = 0.2F;
  float weight = 1.0F;  ///< of this picture in the step, divided by the batch by the caller
  bool encode_srgb = true;
};

/// (1 - lambda) L1 + lambda (1 - SSIM) of `rendered` [batch][3][h][w] against `targets`, a device array of `batch`
/// pointers to u8 RGBA pictures; writes `gradient`, adds each view's loss to workspace.loss. A view whose pointer is
/// null has no loss and a gradient of zero.
void launch_loss(const float* rendered, const std::uint8_t* const* targets, float* gradient,
                 const WorkspaceView& workspace, const LossKernelOptions& options, cudaStream_t stream);

/// `weight` * |depth - alpha * reference| summed over the pixels that have a surface, where the reference, metres, is
/// above 0: linear in depth and alpha, and 0 only where what is blended balances about the surface. `targets` is a
/// device array of `batch` pointers to [h][w]; what `masks` masks has no surface. Writes
/// depth_gradient and alpha_gradient, adds to loss. A view whose pointer is null has no loss and gradients of zero.
void launch_depth_loss(const float* const* targets, const ViewMasks& masks, const WorkspaceView& workspace,
                       float weight, cudaStream_t stream);

/// What a view shows of a page, as raster::PageLook has it, with the errors' sum.
struct PageSums {
  std::uint32_t pairs;
  float error;
};
/// Display-space pictures that views should show, a device array of u8 RGBA each or null, and what of them counts.
struct LookPictures {
  const std::uint8_t* const* targets = nullptr;
  ViewMasks masks;
  bool encode_srgb = true;
};
/// Sums of what each view of the last training forward pass shows of pages, [batch][pages]; tiles are of kTileSize
/// pixels. A view whose target is null shows nothing.
void launch_page_looks(const DeviceGaussians& gaussians, const WorkspaceView& workspace, const LookPictures& pictures,
                       PageSums* sums, int pages, cudaStream_t stream);

struct AdamOptions {
  float beta1 = 0.9F, beta2 = 0.999F, epsilon = 1e-15F;
  const float* learning_rate = nullptr;             ///< [channels]
  int active_channels = 0;                          ///< 0: all
  bool unit_albedo = false;                         ///< Transfer: albedo stays within [0, 1]
  float lr_half_life_steps = 0, lr_min_factor = 0;  ///< as in Adam
  /// Device array of what each view's loss is at most before it has risen (LossHistory); null: rates do not recover.
  const float* loss_limits = nullptr;
};

/// Adam's state in a block for each page of kPageLanes indices that trains: [2 channels + kCounters][kPageLanes], first
/// moments, second moments, steps as integers, LearningAge's two.
struct OptimizerState {
  static constexpr int kCounters = 3;
  float* const* blocks = nullptr;  ///< of each page; null for one that is frozen
  int channels = 0;
};

/// For clone and split, [count]; null: not gathered. `steps` only with `mean2d_norm`.
struct ScreenStatistics {
  float* mean2d_norm = nullptr;    ///< sum over views of |dL/d(projected mean)| in NDC units
  std::uint32_t* steps = nullptr;  ///< in which it was blended into a pixel
};

/// Projection and shading backward, summed over the views, and Adam, in one pass over the Gaussians that were blended
/// into some pixel and are not frozen, which it adds to the statistics. Leaves projected_gradient,
/// projected_depth_gradient and projected_visible zeroed.
void launch_update(const DeviceGaussians& gaussians, const WorkspaceView& workspace, const ProjectOptions& project,
                   const OptimizerState& state, const AdamOptions& adam, const ScreenStatistics& statistics,
                   cudaStream_t stream);

/// The same gradients, added to planes [channels][stride] instead (of a model in pages [channels][count]), and [count]
/// marks of who was blended: for the checks against the reference renderer.
void launch_gradient(const DeviceGaussians& gaussians, const WorkspaceView& workspace, const ProjectOptions& project,
                     float* gradient, std::uint8_t* touched, const ScreenStatistics& statistics, int active_channels,
                     cudaStream_t stream);

}  // namespace splatbus::raster::cuda
