#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "raster/cpu/scratch.h"
#include "raster/rasterizer.h"
#include "raster/shading_source.h"

namespace splatbus::raster::cpu {

constexpr std::uint32_t kTileSide = 8, kBlockSide = 4;
constexpr std::uint32_t kTilePixels = kTileSide * kTileSide, kBlockPixels = kBlockSide * kBlockSide;
constexpr std::uint32_t kTileBlocks = kTilePixels / kBlockPixels;
/// A render without a backward pass lists wide tiles: half as many pairs, which is most of what listing takes, while a
/// pixel still sees what its block reaches only.
constexpr std::uint32_t kWideSide = 16;
constexpr std::uint32_t tile_side(bool keep) {
  return keep ? kTileSide : kWideSide;
}

constexpr float kAlphaMin = 1.0F / 255.0F, kAlphaMax = 0.999F, kTransmittanceMin = 1e-4F;

constexpr double kLog2E = 1.4426950408889634;
/// Squared distances in a Splat are in units in which alpha = 2^(log2_alpha - u^2 - v^2): (x / this)^2 = 2 ln 2 x^2.
constexpr float kWhiteScale = 0.8493218002880191F;  // sqrt(log2(e) / 2)

/// What a render needs of one object's frame: all Gaussians of an object share it, so that light and camera are brought
/// to the Gaussians instead of Gaussians to the world.
struct ObjectFrame {
  std::array<float, 9> camera_from_object{};  ///< row-major rotation times scale
  std::array<float, 3> translation{};         ///< of camera_from_object
  std::array<float, 3> camera_position{};     ///< in the object's frame
  std::array<float, 3> sun_direction{};
  std::array<float, 3> sun_over_pi{};
  std::array<float, 27> ambient{};       ///< 3 k + c: incident ambient light
  std::array<float, 27> ambient_lobe{};  ///< ambient times the clamped cosine's factor over pi
  std::array<float, 27> sun_sh{};        ///< sun irradiance Y_k(l) / pi
  float scale = 1;
  bool emissive = false;  ///< no source lights it
};

/// The frames of every object of a scene; index 0 is the world.
class ObjectTable {
 public:
  void build(const Camera& camera, const SceneState& scene);
  /// What find() says of an object that the scene does not have: its Gaussians do not show.
  static constexpr std::uint32_t kHidden = UINT32_MAX;
  /// Index of the frame of an object id; that of kWorldFrame is 0.
  [[nodiscard]] std::uint32_t find(std::uint32_t object_id) const;
  [[nodiscard]] const ObjectFrame& operator[](std::uint32_t index) const { return frames_[index]; }

 private:
  std::vector<std::uint32_t> ids_;  ///< sorted; ids_[k] has frame k + 1
  std::vector<ObjectFrame> frames_;
};

/// A projected Gaussian, one cache line. With d = pixel centre - (x, y): u = uxx dx + uxy dy, v = uyy dy.
struct alignas(64) Splat {
  float x, y, log2_alpha, uxx;
  float uxy, uyy, red, green;  ///< a colour channel that was clamped to 0 is -0
  float blue, depth, albedo_red, albedo_green;
  float albedo_blue, extent_x, extent_y;  ///< extent: half sides of the box in which alpha can reach 1/255, pixels
  float rightmost_dy;                     ///< dy of the ellipse's rightmost point
};
static_assert(sizeof(Splat) == 64);

/// Sums over the pixels of one tile of one Gaussian, written by the blending backward pass; s = dL/dalpha alpha.
struct alignas(64) PairGradient {
  float s, su, sv, suu;
  float suv, svv, red, green;
  float blue, depth, albedo_red, albedo_green;
  float albedo_blue, largest_weight, unused[2];
};
static_assert(sizeof(PairGradient) == 64);

/// One Gaussian in one tile's list: the Gaussian in the low 28 bits, a mask of the tile's 4x4 blocks that it may reach
/// above.
using TileEntry = std::uint32_t;
constexpr std::uint32_t kBlockShift = 28, kGaussianMask = (1U << kBlockShift) - 1;

/// The same in a wide tile's list: a bit of `blocks` a 4x4 block, row after row.
struct WideEntry {
  std::uint32_t gaussian, blocks;
};

/// The blocks that a Gaussian reaches: 4x4 tiles from `tile` on, row after row, four bits a tile (left to right, then
/// down); blocks[0] has the first two rows of tiles. Or 2x2 wide tiles, a row of tiles in each of `blocks`, sixteen
/// bits a tile.
struct alignas(16) TileReach {
  static constexpr std::uint32_t kLarge = ~0U;  ///< as `tile`: it may reach more tiles than that
  static constexpr std::uint32_t kSide = 4;     ///< tiles
  static constexpr std::uint32_t kWideTiles = 2;
  std::uint32_t tile, blocks[2];
};

/// The pairs of a Gaussian: `count` slots from piece_slot[piece] + first.
struct PairRange {
  std::uint32_t count, piece, first;
};

/// A depth-sort key: the bits of a positive float order like the float.
struct DepthKey {
  std::uint32_t depth_bits, gaussian;
};

/// Everything that a forward pass leaves for its backward pass.
struct Frame {
  bool keep = false;  ///< a backward pass will follow: what only it reads is written
  GaussiansView gaussians;
  Camera camera;
  RenderOptions options;
  ObjectTable objects;
  std::vector<ShadingSource> sources;  ///< besides the sun; Transfer only
  std::array<float, 3> background{};   ///< in the colour plane's space
  float tan_limit_x_low = 0, tan_limit_x_high = 0, tan_limit_y_low = 0, tan_limit_y_high = 0;

  std::uint32_t tiles_x = 0, tiles_y = 0;
  [[nodiscard]] std::uint32_t tile_count() const { return tiles_x * tiles_y; }

  const float* surface_depth = nullptr;   ///< RenderGradient's
  std::vector<IndexRange> pieces;         ///< Gaussians that may show, as they are worked on
  std::vector<std::uint8_t> frozen_page;  ///< by page, where any of `pieces` is frozen; else empty
  Scratch<Splat> splats;                  ///< [count], valid where visible
  Scratch<TileReach> reaches;             ///< [count], valid where visible
  Scratch<PairRange> pair_ranges;         ///< [count], kept, valid in pieces
  std::vector<std::uint32_t> piece_slot;  ///< first slot of every binning piece
  Scratch<DepthKey> order;                ///< visible Gaussians, near to far
  std::size_t visible = 0;

  Scratch<TileEntry> entries;             ///< of tile after tile, near to far, kept
  Scratch<WideEntry> wide_entries;        ///< the same, not kept
  Scratch<std::uint32_t> entry_of_slot;   ///< [pairs], kept
  std::vector<std::uint32_t> tile_begin;  ///< [tile_count + 1]
  std::size_t pairs = 0;

  // Per tile, pixels in block order (kTilePixels each): what the blending backward pass starts from.
  Scratch<float> transmittance;
  Scratch<std::int32_t> last_entry;      ///< index in the tile's list of the last entry that a pixel blends
  Scratch<std::uint32_t> block_entries;  ///< [tile][kTileBlocks] entries after which the block was finished

  // Per entry: a tile's lie together, and neighbouring Gaussians find theirs in the same tiles.
  Scratch<PairGradient> pair_gradients;
  Scratch<std::uint8_t> pair_written;
};

/// Column and row in its tile of the pixel at an index in block order.
template <std::uint32_t kSide = kTileSide>
constexpr std::uint32_t block_order_x(std::uint32_t index) {
  return (index / kBlockPixels) % (kSide / kBlockSide) * kBlockSide + index % kBlockSide;
}
template <std::uint32_t kSide = kTileSide>
constexpr std::uint32_t block_order_y(std::uint32_t index) {
  return index / kBlockPixels / (kSide / kBlockSide) * kBlockSide + index % kBlockPixels / kBlockSide;
}

}  // namespace splatbus::raster::cpu
