#pragma once

#include <bit>
#include <cstdint>

#include "raster/cuda/workspace.h"

namespace splatbus::raster::cuda {

/// An intersection's key: tile, then depth as the bits of its float above those of the near plane, which order alike.
/// 28 bits hold 32 octaves; many tiles leave room for fewer, so that a radix sort needs five passes of 8 bits.
struct SortKey {
  int depth_bits, shift, tile_bits;

  __host__ __device__ explicit SortKey(const WorkspaceView& w) {
    constexpr int kOctaveBits = 28, kBits = 40;
    const auto tiles = static_cast<std::uint32_t>(w.tiles_x * w.tiles_y * w.batch);
    tile_bits = static_cast<int>(std::bit_width(tiles));
    depth_bits = tile_bits + kOctaveBits <= kBits ? kOctaveBits : kBits - tile_bits;
    shift = kOctaveBits - depth_bits;
  }
  __device__ std::uint64_t of(int tile, float depth, float near_m) const {
    const std::uint32_t above = __float_as_uint(depth) - __float_as_uint(fmaxf(near_m, 0.0F));
    const std::uint32_t most = (1U << depth_bits) - 1;
    return static_cast<std::uint64_t>(tile) << depth_bits | min(above >> shift, most);
  }
  /// Of a key; for keys that no intersection filled, all ones, it lies above every tile.
  __device__ std::uint64_t tile(std::uint64_t key) const { return key >> depth_bits; }
};

}  // namespace splatbus::raster::cuda
