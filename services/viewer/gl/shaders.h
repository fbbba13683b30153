#pragma once

// The page's formula (web/src/render/splat.glsl) and the order of its WebGPU, as OpenGL 4.5 has them; a test
// holds the pictures to the CPU rasteriser's. Buffers are bound from 0 on in the order in which a text declares them.
namespace splatbus::viewer::gl {

/// Threads of a group.
inline constexpr unsigned kThreads = 256;
/// Quads of one instance: batches are several times faster than one quad an instance.
inline constexpr unsigned kBatch = 128;
/// How long a row takes to appear and to vanish.
inline constexpr float kFade_s = 0.25F;

/// Writes changed rows to where they belong: words from kScatterBegin to kScatterEnd of what was uploaded; words a row,
/// of how many in the store, from which on.
extern const char* const kScatterText;
enum ScatterLocation : int { kScatterBegin = 0, kScatterEnd = 1, kScatterWords = 2 };

/// Keeps the colors of rows: of those that were uploaded last, or of all up to kKeepRows.
extern const char* const kKeepText;
enum KeepLocation : int { kKeepRows = 0, kKeepChanged = 1 };

/// Of every row what its quad needs, and a key: nearer is greater; ~0 where nothing can show.
extern const char* const kProjectText;
enum ProjectLocation : int {
  kRows = 0,
  kPinhole = 1,
  kSize = 2,  ///< of kSplatVertexText as well
  kTangents = 3,
  kTime = 4,
  kAntialias = 5,
  kHarmonicWords = 6,
  kNear = 7,
  kColorPart = 8
};

/// A stable radix sort of the keys of what is seen: equal depths keep the order of rows, so that nothing flickers.
/// Where the seen rows of each group go, and how many there are: Seen.
extern const char* const kCountSeenText;
/// The seen rows and their keys, closed up.
extern const char* const kCloseUpText;
/// Three steps a digit: how often each occurs in each block, where each digit of each block begins, and every key to
/// its place.
extern const char* const kHistogramText;
extern const char* const kScanCountsText;
extern const char* const kReorderText;
enum SortLocation : int { kShift = 0 };
inline constexpr unsigned kKeyBits = 25;
inline constexpr unsigned kDigitBits = 5;
inline constexpr unsigned kDigits = 1U << kDigitBits;
/// Keys that a group sorts at a time.
inline constexpr unsigned kBlock = 16 * kThreads;

/// How many there are to sort, and the groups that do it.
struct Counted {
  unsigned rows;
  unsigned groups[3];
};

/// What kCountSeenText writes: so much is seen, and is to be dispatched and drawn. Groups: of kThreads rows.
struct Seen {
  Counted counted;
  unsigned draw[5];
  unsigned row_groups[3];
};

/// Quads that cover exactly what a Gaussian can reach: a square in the whitened plane, brought to pixels by the
/// Cholesky factor of the covariance. Any root of it would do; all have the same area.
extern const char* const kSplatVertexText;
extern const char* const kSplatFragmentText;
/// Background and sRGB curve over the splats' picture.
extern const char* const kResolveVertexText;
extern const char* const kResolveFragmentText;
enum ResolveLocation : int { kBackground = 0, kDisplaySpace = 1 };

/// The other way to draw: lists of what each tile of the picture shows, near to far, each blended by one group.
/// Of every seen row, nearest first, how many tiles it touches.
extern const char* const kCountTilesText;
/// Where the pairs of each group of rows go, and whether there is room for all: Pairs. If so, no quads are drawn.
extern const char* const kCountPairsText;
/// Pairs of a tile and a row, nearest rows first.
extern const char* const kPairText;
/// Of the pairs in the order of tiles, where each tile's begin and end.
extern const char* const kRangesText;
/// Each tile to the picture: premultiplied colour and alpha, as the quads leave it.
extern const char* const kBlendText;
enum TileLocation : int { kPixels = 0, kTiles = 1, kCapacity = 2 };
/// Pixels of a tile's side.
inline constexpr unsigned kTileSide = 16;
/// Up to here the device counts pairs without error.
inline constexpr unsigned kMostCounted = 0xffffff;

/// What kCountPairsText writes. Where there is no room all is 0 but `wanted`.
struct Pairs {
  Counted counted;
  unsigned row_groups[3];  ///< of kPairText
  unsigned wanted;
};

}  // namespace splatbus::viewer::gl
