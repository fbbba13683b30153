#include "capture-bridge/sampling.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "capture-bridge/culling.h"
#include "capture-bridge/sample_math.h"
#include "capture-bridge/spacing.h"
#include "capture-bridge/thinning.h"

namespace splatbus::capture_bridge {

namespace {

glm::vec3 glm_from(const Vec3& v) {
  return {v.x, v.y, v.z};
}

/// Where a sample that survived culling lies.
struct Source {
  std::uint32_t view;
  std::uint32_t pixel;  ///< among all views'
};

struct Survivors {
  std::vector<Source> source;
  std::vector<glm::vec3> position;
  std::vector<float> area_m2;
};

std::array<std::uint32_t, kRanks> rank_counts(std::span<const SurfaceRank> ranks) {
  std::array<std::uint32_t, kRanks> of_rank{};
  for (const SurfaceRank& rank : ranks) ++of_rank[rank.rank];
  return of_rank;
}

Survivors survivors_of(const PixelViews& views, const RoundSurface& surface, std::span<const SurfaceRank> ranks,
                       int cameras_per_surface, std::size_t count) {
  Survivors survivors;
  survivors.source.reserve(count);
  survivors.position.reserve(count);
  survivors.area_m2.reserve(count);
  for (std::uint32_t v = 0; v < views.views.size(); ++v) {
    const PixelView& view = views.views[v];
    const std::uint32_t end = view.first_pixel + view.width * view.height;
    for (std::uint32_t i = view.first_pixel; i < end; ++i) {
      if (ranks[i].rank == 0 || ranks[i].rank > cameras_per_surface) continue;
      survivors.source.push_back({v, i});
      survivors.position.push_back(glm_from(position_in_round(view, surface.texels[i])));
      survivors.area_m2.push_back(area_of(surface.texels[i], ranks[i], cameras_per_surface));
    }
  }
  return survivors;
}

void fill_samples(const PixelViews& views, const RoundSurface& surface, const Survivors& survivors,
                  std::span<const std::uint32_t> kept, SampleSet& samples) {
  const LinearTable& linear = linear_table();
  samples.resize(kept.size());
  tbb::parallel_for(std::size_t{0}, kept.size(), [&](std::size_t k) {
    const Source source = survivors.source[kept[k]];
    const PixelView& view = views.views[source.view];
    const Texel& texel = surface.texels[source.pixel];
    const std::size_t in_view = source.pixel - view.first_pixel;
    samples.position[k] = survivors.position[kept[k]];
    samples.normal[k] = glm_from(normal_in_round(view, texel));
    samples.color[k] = glm_from(without_background(linear, view.color + 4 * in_view, view.background));
    samples.albedo[k] = glm_from(without_background(linear, view.albedo + 4 * in_view, {}));
    samples.footprint_m[k] = std::abs(texel.footprint_m);
    samples.cosine[k] = surface.cosine[source.pixel];
    samples.object_id[k] = texel.object_id;
    samples.camera[k] = source.view;
  });
}

}  // namespace

ContentHeights content_heights(const SampleSet& samples) {
  if (samples.size() == 0) return {};
  std::vector<float> heights;
  heights.reserve(samples.size());
  for (const glm::vec3& position : samples.position) heights.push_back(position.y);
  const auto at = [&heights](std::size_t rank) {
    const auto place = heights.begin() + static_cast<std::ptrdiff_t>(rank);
    std::nth_element(heights.begin(), place, heights.end());
    return *place;
  };
  const HeightRanks ranks = height_ranks(samples.size());
  return {.low_m = at(ranks.low), .high_m = at(ranks.high)};
}

SampledRound sample_views(Views views, const ObjectTransforms& round_objects, const SamplingOptions& options) {
  SampledRound round;
  const PixelViews pixels = pixel_views(views, round_objects);
  RoundSurface surface = analyse_surfaces(pixels, options.surface);
  const std::vector<SurfaceRank> ranks = rank_across_cameras(pixels, surface.texels, options.culling);
  const auto of_rank = rank_counts(ranks);
  const std::size_t survived = settle_counts(of_rank, options, round);
  const Survivors survivors = survivors_of(pixels, surface, ranks, round.cameras_per_surface, survived);
  const std::vector<std::uint32_t> kept = thin_to_budget(survivors.position, survivors.area_m2, options.budget);
  round.thinned = survived - kept.size();
  fill_samples(pixels, surface, survivors, kept, round.samples);
  const float thinning = spacing_growth(survived, kept.size());
  std::vector<float> fallback_m(kept.size());
  for (std::size_t k = 0; k < kept.size(); ++k) fallback_m[k] = std::sqrt(survivors.area_m2[kept[k]]) * thinning;
  round.samples.spacing_m = estimate_spacing(round.samples.position, round.samples.normal, fallback_m);
  round.dropped = std::move(surface.dropped);
  round.depth_m = std::move(surface.depth_m);
  return round;
}

}  // namespace splatbus::capture_bridge
