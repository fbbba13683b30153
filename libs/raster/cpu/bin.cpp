#include "raster/cpu/bin.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace splatbus::raster::cpu {
namespace {

constexpr std::size_t kPiece = 8192;
/// A bound on memory (20 bytes a pair, 84 while training) that only a model gone wrong, all of whose Gaussians cover
/// the picture, can reach; beyond it the farthest Gaussians of a piece are left out.
constexpr std::size_t kMaxPairs = std::size_t{1} << 26U;

/// Blocks [first, last] of a row of blocks; empty when first > last.
struct Span {
  int first = 1, last = 0;
  [[nodiscard]] bool empty() const { return first > last; }
  [[nodiscard]] std::uint32_t bits(int block) const {
    return static_cast<std::uint32_t>(first <= block && block <= last) |
           static_cast<std::uint32_t>(first <= block + 1 && block + 1 <= last) << 1U;
  }
};

/// The pixels of an ellipse: u^2 + v^2 <= reach2 with u, v as in Splat.
struct Ellipse {
  const Splat& splat;
  float reach2, inverse_uxx;
  int first_row, last_row;  // pixels
  int width;

  Ellipse(const Splat& s, const Camera& camera)
      : splat(s),
        reach2(s.log2_alpha + 7.9943534F + 1e-3F),
        inverse_uxx(1 / s.uxx),
        first_row(static_cast<int>(std::ceil(std::max(s.y - s.extent_y - 0.5F, 0.0F)))),
        last_row(
            static_cast<int>(std::floor(std::min(s.y + s.extent_y - 0.5F, static_cast<float>(camera.height) - 1)))),
        width(static_cast<int>(camera.width)) {}

  /// The blocks of one block row that hold a pixel centre within the ellipse's extent over the row's centres: in a band
  /// of dy, the ellipse's right end lies at its rightmost point's dy, clamped to the band.
  [[nodiscard]] Span blocks_of_row(int block_row) const {
    const int first = std::max(block_row * static_cast<int>(kBlockSide), first_row);
    const int last = std::min(block_row * static_cast<int>(kBlockSide) + static_cast<int>(kBlockSide) - 1, last_row);
    if (first > last) return {};
    const float low = static_cast<float>(first) + 0.5F - splat.y, high = static_cast<float>(last) + 0.5F - splat.y;
    const auto half_width = [&](float dy) {
      const float v = splat.uyy * dy;
      return std::sqrt(std::max(reach2 - v * v, 0.0F));
    };
    const float right_dy = std::clamp(splat.rightmost_dy, low, high);
    const float left_dy = std::clamp(-splat.rightmost_dy, low, high);
    constexpr float kMargin = 0.01F;
    const float right = splat.x + (half_width(right_dy) - splat.uxy * right_dy) * inverse_uxx + kMargin;
    const float left = splat.x - (half_width(left_dy) + splat.uxy * left_dy) * inverse_uxx - kMargin;
    const auto edge = static_cast<float>(width) - 1;
    // A pixel centre must lie between; comparisons are written so that NaN gives the whole row.
    const int first_column = left > 0.5F ? static_cast<int>(std::ceil(std::min(left - 0.5F, edge + 1))) : 0;
    const int last_column =
        right - 0.5F < edge ? static_cast<int>(std::floor(std::max(right - 0.5F, -1.0F))) : width - 1;
    if (first_column > last_column) return {};
    return {first_column / static_cast<int>(kBlockSide), last_column / static_cast<int>(kBlockSide)};
  }
};

}  // namespace

void TileBinner::collect(Frame& frame, std::size_t begin, std::size_t end, std::size_t most, Piece& piece) {
  constexpr int kBlocksPerSide = kTileSide / kBlockSide;
  static_assert(kBlocksPerSide == 2);
  piece.pending.clear();
  piece.tile_counts.assign(frame.tile_count(), 0);
  for (std::size_t k = begin; k < end && piece.pending.size() < most; ++k) {
    const std::uint32_t gaussian = frame.order[k].gaussian;
    const Ellipse ellipse(frame.splats[gaussian], frame.camera);
    const std::size_t before = piece.pending.size();
    for (int tile_y = ellipse.first_row / static_cast<int>(kTileSide);
         tile_y <= ellipse.last_row / static_cast<int>(kTileSide); ++tile_y) {
      const Span top = ellipse.blocks_of_row(2 * tile_y), bottom = ellipse.blocks_of_row(2 * tile_y + 1);
      if (top.empty() && bottom.empty()) continue;
      const int first = top.empty() ? bottom.first : bottom.empty() ? top.first : std::min(top.first, bottom.first);
      const int last = std::max(top.last, bottom.last);
      for (int tile_x = first / kBlocksPerSide; tile_x <= last / kBlocksPerSide; ++tile_x) {
        const std::uint32_t blocks = top.bits(2 * tile_x) | bottom.bits(2 * tile_x) << 2U;
        if (blocks == 0) continue;
        const std::uint32_t tile =
            static_cast<std::uint32_t>(tile_y) * frame.tiles_x + static_cast<std::uint32_t>(tile_x);
        ++piece.tile_counts[tile];
        piece.pending.push_back({tile, gaussian | blocks << kBlockShift});
      }
    }
    frame.pair_count[gaussian] = static_cast<std::uint32_t>(piece.pending.size() - before);
  }
}

void TileBinner::bin(Frame& frame, Workers& workers) {
  const std::size_t piece_count = (frame.visible + kPiece - 1) / kPiece;
  pieces_.resize(piece_count);
  workers.for_pieces(frame.visible, kPiece, [&](std::size_t begin, std::size_t end) {
    collect(frame, begin, end, kMaxPairs / piece_count, pieces_[begin / kPiece]);
  });

  frame.pairs = 0;
  for (Piece& piece : pieces_) {
    piece.first_slot = frame.pairs;
    frame.pairs += piece.pending.size();
  }
  frame.tile_begin.resize(frame.tile_count() + 1);
  std::uint32_t next = 0;
  for (std::uint32_t tile = 0; tile < frame.tile_count(); ++tile) {
    frame.tile_begin[tile] = next;
    for (Piece& piece : pieces_) next += std::exchange(piece.tile_counts[tile], next);
  }
  frame.tile_begin[frame.tile_count()] = next;

  frame.entries.reserve(frame.pairs);
  workers.for_pieces(frame.visible, kPiece, [&](std::size_t begin, std::size_t) {
    Piece& piece = pieces_[begin / kPiece];
    auto slot = static_cast<std::uint32_t>(piece.first_slot);
    std::uint32_t previous = ~0U;
    for (const Pending& pending : piece.pending) {
      const std::uint32_t gaussian = pending.gaussian_and_blocks & kGaussianMask;
      if (gaussian != previous) frame.first_slot[gaussian] = slot;
      previous = gaussian;
      frame.entries[piece.tile_counts[pending.tile]++] = {pending.gaussian_and_blocks, slot++};
    }
  });
}

}  // namespace splatbus::raster::cpu
