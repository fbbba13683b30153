#include "capture-bridge/culling.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cassert>

namespace splatbus::capture_bridge {

namespace {

/// Pixels of a tile's side: what another camera sees of a tile fits into the smallest cache.
constexpr std::uint32_t kTile = 8;
constexpr std::uint32_t kTilePixels = kTile * kTile;

/// Ranks tile by tile, and in a tile camera by camera: the lookups jump about, and so they stay in one place for a
/// while. Not thread-safe.
class TileRanking {
 public:
  TileRanking(const PixelViews& views, std::span<const Texel> texels, const CullOptions& options)
      : views_(views),
        texels_(texels),
        similar_(options.similar),
        sight_(views.views.data(), texels.data(), views.movement(), options),
        quality_(views.views.size() * kTilePixels) {}

  /// The tile of view `own` whose first pixel is (x, y).
  void rank(std::uint32_t own, std::uint32_t x, std::uint32_t y, std::vector<SurfaceRank>& ranks) {
    collect(views_.views[own], x, y);
    const auto view_count = static_cast<std::uint32_t>(views_.views.size());
    for (std::uint32_t view = 0; view < view_count; ++view) {
      float* const quality = quality_.data() + std::size_t{view} * kTilePixels;
      for (std::uint32_t s = 0; s < samples_; ++s) {
        const Texel& point = texels_[pixel_[s]];
        if (view == own) {
          quality[s] = sight_.own_quality(own, point);
        } else if (!sight_.sees(view, own, point, quality[s])) {
          quality[s] = kUnseen;
        }
      }
    }
    for (std::uint32_t s = 0; s < samples_; ++s) {
      const auto sees = [&](std::uint32_t other, float& found) {
        found = quality_[other * kTilePixels + s];
        return found != kUnseen;
      };
      ranks[pixel_[s]] = rank_among(view_count, own, quality_[own * kTilePixels + s], similar_, sees);
    }
  }

 private:
  static constexpr float kUnseen = -1;

  /// The tile's samples.
  void collect(const PixelView& view, std::uint32_t x0, std::uint32_t y0) {
    samples_ = 0;
    for (std::uint32_t y = y0; y < std::min(y0 + kTile, view.height); ++y) {
      for (std::uint32_t x = x0; x < std::min(x0 + kTile, view.width); ++x) {
        const std::uint32_t pixel = view.first_pixel + y * view.width + x;
        if (texels_[pixel].footprint_m != 0) pixel_[samples_++] = pixel;
      }
    }
  }

  const PixelViews& views_;
  std::span<const Texel> texels_;
  float similar_;
  Sight sight_;
  std::uint32_t samples_ = 0;
  std::array<std::uint32_t, kTilePixels> pixel_{};
  std::vector<float> quality_;  // [view][sample]
};

}  // namespace

std::vector<SurfaceRank> rank_across_cameras(const PixelViews& views, std::span<const Texel> texels,
                                             const CullOptions& options) {
  assert(texels.size() == views.pixels);
  std::vector<SurfaceRank> ranks(texels.size());
  tbb::parallel_for(std::uint32_t{0}, static_cast<std::uint32_t>(views.views.size()), [&](std::uint32_t own) {
    const PixelView& view = views.views[own];
    using Rows = tbb::blocked_range<std::uint32_t>;
    tbb::parallel_for(Rows(0, (view.height + kTile - 1) / kTile), [&](const Rows& rows) {
      TileRanking ranking(views, texels, options);
      for (std::uint32_t row = rows.begin(); row < rows.end(); ++row) {
        for (std::uint32_t x = 0; x < view.width; x += kTile) ranking.rank(own, x, row * kTile, ranks);
      }
    });
  });
  return ranks;
}

}  // namespace splatbus::capture_bridge
