#include "raster/cpu/bin.h"

#include <algorithm>

#include "raster/cpu/kernels.h"

namespace splatbus::raster::cpu {
namespace {

constexpr std::size_t kPiece = 8192;
/// A bound on memory (12 bytes a pair, 81 while training) that only a model gone wrong, all of whose Gaussians cover
/// the picture, can reach; beyond it the farthest Gaussians of a piece are left out.
constexpr std::size_t kMaxPairs = std::size_t{1} << 26U;

}  // namespace

void TileBinner::bin(Frame& frame, Workers& workers) {
  const std::size_t piece_count = (frame.visible + kPiece - 1) / kPiece;
  pieces_.resize(piece_count);
  workers.for_pieces(frame.visible, kPiece, [&](std::size_t begin, std::size_t end) {
    const std::size_t index = begin / kPiece;
    Piece& piece = pieces_[index];
    piece.tile_counts.assign(std::max(frame.tile_count(), 1U), 0);  // what is not reached counts zero at the first
    collect_pairs(frame, begin, end, static_cast<std::uint32_t>(index), kMaxPairs / piece_count, piece.pairs,
                  piece.tile_counts.data());
  });

  frame.pairs = 0;
  frame.piece_slot.clear();
  for (Piece& piece : pieces_) {
    frame.piece_slot.push_back(static_cast<std::uint32_t>(frame.pairs));
    frame.pairs += piece.pairs.size();
  }
  frame.tile_begin.resize(frame.tile_count() + 1);
  scan_.scan(
      piece_count, frame.tile_count(), [&](std::size_t piece) { return pieces_[piece].tile_counts.data(); },
      frame.tile_begin.data());

  frame.entries.reserve(frame.pairs);
  if (frame.keep) frame.entry_of_slot.reserve(frame.pairs);
  workers.for_pieces(frame.visible, kPiece, [&](std::size_t begin, std::size_t) {
    Piece& piece = pieces_[begin / kPiece];
    TileEntry* entries = frame.entries.data();
    std::uint32_t* next_entry = piece.tile_counts.data();
    if (!frame.keep) {
      for (const Pair& pair : piece.pairs) entries[next_entry[pair.tile]++] = pair.gaussian_and_blocks;
      return;
    }
    std::uint32_t* entry_of_slot = frame.entry_of_slot.data() + frame.piece_slot[begin / kPiece];
    for (const Pair& pair : piece.pairs) {
      const std::uint32_t entry = next_entry[pair.tile]++;
      entries[entry] = pair.gaussian_and_blocks;
      *entry_of_slot++ = entry;
    }
  });
}

}  // namespace splatbus::raster::cpu
