#pragma once

#include <cmath>
#include <cstdint>

#include "gaussians/layout.h"
#include "gaussians/occlusion.h"
#include "gaussians/pages.h"
#include "raster/shading_source.h"

namespace splatbus::raster::cuda {

/// Views trained or rendered in one launch.
constexpr int kMaxBatch = 16;
/// The slot of Gaussians whose object no view has: nothing draws them.
constexpr std::uint16_t kHiddenSlot = 0xFFFF;
/// Objects that move, the world itself included (slot 0).
constexpr int kMaxObjects = kHiddenSlot;
/// Intersections of a Gaussian with a tile that one sort takes.
constexpr std::uint32_t kMaxIsects = (1U << 31U) - 1024;
/// Pixels of a tile's side. A tile has one list of Gaussians; each of its patches is blended by one warp.
constexpr int kTileSize = 16;
constexpr int kPatchWidth = 8, kPatchHeight = 4;
constexpr int kPatchColumns = kTileSize / kPatchWidth, kPatchRows = kTileSize / kPatchHeight;
constexpr int kPatches = kPatchColumns * kPatchRows;  // of a tile

/// What a view needs of one object: everything is folded into the object's frame, so that kernels never see the world.
struct ObjectView {
  float view_from_object[12];  ///< row-major 3x4, rotation times scale
  float camera_in_object[3];   ///< camera centre, for view-dependent SH
  float sun_direction[3];      ///< Transfer, in the object's frame
  float ambient_sh[27];        ///< Transfer, [9][3], incident radiance in the object's frame
  float sun_irradiance[3];
  float scale;
  int source_count;  ///< of the view's sources that light it: all, or none where it is emissive
};

/// What an object looks like to a view whose scene does not have it: behind every camera.
inline ObjectView hidden_object() {
  ObjectView out{};
  out.view_from_object[11] = -INFINITY;
  return out;
}
SPLATBUS_PORTABLE bool is_hidden(const ObjectView& object) {
  return object.view_from_object[11] == -INFINITY;
}

/// One camera of a batch. All cameras of a batch have one size.
struct DeviceView {
  const std::uint8_t* visibility;  ///< of the sun, by index; null: the Gaussians' own
  FarthestSurfaces hidden_behind;
  float fx, fy, cx, cy;  ///< pixels
  float near_m;
  float limit_x_low, limit_x_high, limit_y_low, limit_y_high;  ///< clamp of x/z and y/z in the Jacobian
  float background[3];                                         ///< in the space that is blended in
};

/// Device pointers to a model; channels, pages and ranges as in GaussiansView. Kernels reach channels through
/// gaussian_channels.cuh.
struct DeviceGaussians {
  ParameterLayout layout;
  int count = 0;                        ///< indices below it may be Gaussians
  std::int64_t stride = 0;              ///< elements from one channel to the next
  std::uint32_t page_shift = kNoPages;  ///< index >> page_shift is the page
  std::int64_t page_stride = 0;         ///< 4-byte words from one page to the next
  const IndexRange* ranges = nullptr;   ///< [range_count]; null: all indices are Gaussians
  PageBounds* bounds = nullptr;         ///< [range_count]; a training step keeps them true; null: unknown
  int range_count = 0;
  float* parameters = nullptr;
  const float* normal = nullptr;
  const float* visibility = nullptr;
  /// As GaussiansView's. Kernels read a view's own: whoever draws takes it from here.
  const std::uint8_t* visibility_u8 = nullptr;
  std::size_t visibility_stride = 0;
  std::uint32_t visibility_rows = 1;
  const std::uint32_t* object_id = nullptr;
  const std::uint32_t* flags = nullptr;

  [[nodiscard]] bool has_pages() const { return page_shift != kNoPages; }
};

}  // namespace splatbus::raster::cuda
