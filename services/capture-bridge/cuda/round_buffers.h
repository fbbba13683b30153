#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>
#include <cstdint>

#include "capture-bridge/culling_math.h"
#include "capture-bridge/neighbour_tree.h"
#include "capture-bridge/thinning_math.h"
#include "device/buffer.h"

namespace splatbus::capture_bridge::cuda {

using device::Buffer;

/// Kinds of PixelFault.
constexpr std::size_t kFaults = 4;
constexpr std::size_t kMostViews = 255;

/// What the host needs to know of a round's pixels.
struct RoundTally {
  std::uint32_t of_rank[256];
  std::uint32_t faults[kMostViews][kFaults];
};

/// A round's pixels: those of view v begin at v * view_pixels. Pointers to device memory.
struct RoundPixels {
  const PixelView* views = nullptr;
  std::uint32_t view_count = 0;
  std::uint32_t view_pixels = 0;  ///< of each view, all of one size
  bool movement = false;
  float* depth_m = nullptr;
  float* cosine = nullptr;
  std::uint32_t* object_id = nullptr;
  Texel* texels = nullptr;
  SurfaceRank* ranks = nullptr;

  [[nodiscard]] std::uint32_t pixels() const { return view_count * view_pixels; }
};

/// Samples that culling has left.
struct Survivors {
  std::uint32_t count = 0;
  std::uint32_t* pixel = nullptr;  ///< [count] among all views'
  float* position = nullptr;       ///< [count, 3] in the round's frame
  float* area_m2 = nullptr;        ///< [count]
};

/// A round's result, arrays of schemas/capture.fbs.
struct SampleArrays {
  std::uint32_t count = 0;
  float *position = nullptr, *normal = nullptr, *albedo = nullptr, *color = nullptr;
  float *footprint_m = nullptr, *spacing_m = nullptr, *cosine = nullptr;
  std::uint32_t *object_id = nullptr, *camera = nullptr;
};

/// Device memory of thinning, kept from round to round.
struct ThinningMemory {
  Buffer<Box> bounds;
  Buffer<std::uint64_t> codes, codes_sorted;
  Buffer<std::uint32_t> index, order;  ///< order: survivors along the Morton curve
  Buffer<float> areas_sorted;
  Buffer<double> area_sums;
  Buffer<std::uint64_t> shares, share_sums;
  Buffer<std::uint32_t> certain;
  Buffer<std::uint32_t> kept;  ///< survivors that stay, in Morton order
  Buffer<std::byte> scratch;

  void resize(std::size_t survivors) {
    bounds.resize(1);
    certain.resize(1);
    for (auto* longs : {&codes, &codes_sorted, &shares, &share_sums}) longs->resize(survivors);
    for (auto* words : {&index, &order, &kept}) words->resize(survivors);
    areas_sorted.resize(survivors);
    area_sums.resize(survivors);
  }
};

}  // namespace splatbus::capture_bridge::cuda
