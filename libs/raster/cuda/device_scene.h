#pragma once

#include <cstdint>

#include "gaussians/layout.h"

namespace splatbus::raster::cuda {

/// Views trained or rendered in one launch.
constexpr int kMaxBatch = 16;
/// Objects that move, the world itself included (slot 0): a slot has 16 bits.
constexpr int kMaxObjects = 1 << 16;
/// Intersections of a Gaussian with a tile that one sort takes.
constexpr std::uint32_t kMaxIsects = (1U << 31U) - 1024;
/// Pixels of a tile's side. A tile has one list of Gaussians; each of its patches is blended by one warp.
constexpr int kTileSize = 16;
constexpr int kPatchWidth = 8, kPatchHeight = 4;
constexpr int kPatchColumns = kTileSize / kPatchWidth, kPatchRows = kTileSize / kPatchHeight;
constexpr int kPatches = kPatchColumns * kPatchRows;  // of a tile

/// What a view needs of one object: everything is folded into the object's frame, so that kernels never see the world.
struct ObjectView {
  float view_from_object[12];  ///< row-major 3x4
  float camera_in_object[3];   ///< camera centre, for view-dependent SH
  float sun_direction[3];      ///< Transfer, in the object's frame
  float ambient_sh[27];        ///< Transfer, [9][3], incident radiance in the object's frame
  float sun_irradiance[3];
};

/// One camera of a batch. All cameras of a batch have one size.
struct DeviceView {
  float fx, fy, cx, cy;  ///< pixels
  float near_m;
  float limit_x_low, limit_x_high, limit_y_low, limit_y_high;  ///< clamp of x/z and y/z in the Jacobian
  float background[3];                                         ///< in the space that is blended in
};

/// Device pointers to a model; channels as in GaussiansView. Kernels reach them through gaussian_channels.cuh.
struct DeviceGaussians {
  ParameterLayout layout;
  int count = 0;
  std::int64_t stride = 0;
  float* parameters = nullptr;
  const float* normal = nullptr;
  const float* visibility = nullptr;
  const std::uint32_t* object_id = nullptr;
  const std::uint32_t* flags = nullptr;
};

}  // namespace splatbus::raster::cuda
