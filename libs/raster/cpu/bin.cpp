#include "raster/cpu/bin.h"

#include <algorithm>

#include "raster/cpu/kernels.h"

namespace splatbus::raster::cpu {
namespace {

constexpr std::size_t kPiece = 8192;
/// A bound on memory (20 bytes a pair, 81 while training) that only a model gone wrong, all of whose Gaussians cover
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
    const std::size_t most = kMaxPairs / piece_count;
    if (frame.keep) {
      collect_pairs(frame, begin, end, static_cast<std::uint32_t>(index), most, piece.pairs, piece.tile_counts.data());
    } else {
      collect_wide_pairs(frame, begin, end, most, piece.wide_pairs, piece.tile_counts.data());
    }
  });

  frame.pairs = 0;
  frame.piece_slot.clear();
  for (Piece& piece : pieces_) {
    frame.piece_slot.push_back(static_cast<std::uint32_t>(frame.pairs));
    frame.pairs += frame.keep ? piece.pairs.size() : piece.wide_pairs.size();
  }
  frame.tile_begin.resize(frame.tile_count() + 1);
  scan_.scan(
      piece_count, frame.tile_count(), [&](std::size_t piece) { return pieces_[piece].tile_counts.data(); },
      frame.tile_begin.data());

  if (frame.keep) {
    frame.entries.reserve(frame.pairs);
    frame.entry_of_slot.reserve(frame.pairs);
  } else {
    frame.wide_entries.reserve(frame.pairs);
  }
  workers.for_pieces(frame.visible, kPiece, [&](std::size_t begin, std::size_t) {
    Piece& piece = pieces_[begin / kPiece];
    std::uint32_t* next_entry = piece.tile_counts.data();
    if (!frame.keep) {
      WideEntry* wide_entries = frame.wide_entries.data();
      for (const WidePair& pair : piece.wide_pairs) {
        wide_entries[next_entry[pair.tile]++] = {pair.gaussian, pair.blocks};
      }
      return;
    }
    TileEntry* entries = frame.entries.data();
    std::uint32_t* entry_of_slot = frame.entry_of_slot.data() + frame.piece_slot[begin / kPiece];
    for (const Pair& pair : piece.pairs) {
      const std::uint32_t entry = next_entry[pair.tile]++;
      entries[entry] = pair.gaussian_and_blocks;
      *entry_of_slot++ = entry;
    }
  });
}

}  // namespace splatbus::raster::cpu
