#include "capture-bridge/culling.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <cassert>

namespace splatbus::capture_bridge {

std::vector<SurfaceRank> rank_across_cameras(const PixelViews& views, std::span<const Texel> texels,
                                             const CullOptions& options) {
  assert(texels.size() == views.pixels);
  std::vector<SurfaceRank> ranks(texels.size());
  const auto count = static_cast<std::uint32_t>(views.views.size());
  const Ranking ranking(views.views.data(), count, texels.data(), views.movement(), options);
  tbb::parallel_for(std::uint32_t{0}, count, [&](std::uint32_t own) {
    const PixelView& view = views.views[own];
    const auto pixels = static_cast<std::size_t>(view.width) * view.height;
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, pixels, 2048),
                      [&](const tbb::blocked_range<std::size_t>& range) {
                        for (std::size_t i = range.begin(); i < range.end(); ++i) {
                          ranks[view.first_pixel + i] = ranking.rank(own, i);
                        }
                      });
  });
  return ranks;
}

}  // namespace splatbus::capture_bridge
