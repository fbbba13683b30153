#include "capture-bridge/sampling.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "capture-bridge/spacing.h"
#include "capture-bridge/thinning.h"

namespace splatbus::capture_bridge {

namespace {

constexpr float kLeastCoverage = 0.25F;  // below this a pixel is mostly background, and dividing by it amplifies noise

const std::array<float, 256>& linear_table() {
  static const std::array<float, 256> table = [] {
    std::array<float, 256> values{};
    for (std::size_t i = 0; i < values.size(); ++i) values[i] = linear_from_srgb(static_cast<float>(i) / 255.0F);
    return values;
  }();
  return table;
}

glm::vec3 linear(const Rgba8& pixel) {
  const auto& table = linear_table();
  return {table[pixel[0]], table[pixel[1]], table[pixel[2]]};
}

/// The surface's share of a pixel that is partly background.
glm::vec3 without_background(const glm::vec3& blended, std::uint8_t alpha, const glm::vec3& background) {
  const float coverage = static_cast<float>(alpha) / 255.0F;
  if (alpha == 255 || coverage < kLeastCoverage) return blended;
  return glm::clamp((blended - (1 - coverage) * background) / coverage, glm::vec3(0), glm::vec3(1));
}

/// Where a sample that survived culling lies.
struct Source {
  std::uint32_t view;
  std::uint32_t pixel;
};

struct Survivors {
  std::vector<Source> source;
  std::vector<glm::vec3> position;
  std::vector<float> area_m2;
};

/// The most cameras a surface whose samples are within the budget, or little above it: thinning evens out what several
/// cameras' grids leave, but a single camera's grid is more even than anything thinned.
int cameras_within_budget(const std::vector<SurfaceRanks>& ranks, std::size_t budget) {
  std::array<std::size_t, 256> of_rank{};
  for (const SurfaceRanks& view : ranks) {
    for (const std::uint8_t rank : view.rank) ++of_rank[rank];
  }
  const std::size_t most = budget + budget / 8;
  int cameras = 1;
  std::size_t samples = of_rank[1];
  while (cameras < 255 && of_rank[static_cast<std::size_t>(cameras) + 1] > 0) {
    samples += of_rank[static_cast<std::size_t>(cameras) + 1];
    if (samples > most) break;
    ++cameras;
  }
  return cameras;
}

Survivors survivors_of(Views views, std::span<const ViewSurface> surfaces, const std::vector<SurfaceRanks>& ranks,
                       int cameras_per_surface, std::span<const ObjectTransforms> to_round) {
  Survivors survivors;
  for (std::uint32_t v = 0; v < views.size(); ++v) {
    for (std::uint32_t i = 0; i < ranks[v].rank.size(); ++i) {
      if (ranks[v].rank[i] == 0 || ranks[v].rank[i] > cameras_per_surface) continue;
      glm::vec3 position(views[v]->position[i]);
      if (!to_round[v].empty()) {
        const auto found = to_round[v].find(surfaces[v].object_id[i]);
        if (found != to_round[v].end()) position = found->second * position;
      }
      survivors.source.push_back({v, i});
      survivors.position.push_back(position);
      // The winners' footprints are about the same; they share the surface.
      const float footprint = surfaces[v].footprint_m[i];
      survivors.area_m2.push_back(footprint * footprint /
                                  static_cast<float>(std::min<int>(cameras_per_surface, ranks[v].seen_by[i])));
    }
  }
  return survivors;
}

}  // namespace

void SampleSet::resize(std::size_t count) {
  for (auto* vectors : {&position, &normal, &albedo, &color}) vectors->resize(count);
  for (auto* scalars : {&footprint_m, &spacing_m, &cosine}) scalars->resize(count);
  for (auto* ids : {&object_id, &camera}) ids->resize(count);
}

SampledRound sample_views(Views views, const ObjectTransforms& round_objects, const SamplingOptions& options) {
  SampledRound round;
  std::vector<ViewSurface> surfaces(views.size());
  tbb::parallel_for(std::size_t{0}, views.size(),
                    [&](std::size_t v) { surfaces[v] = analyse_surface(*views[v], options.surface); });
  const std::vector<SurfaceRanks> ranks = rank_across_cameras(views, surfaces, options.culling);
  round.cameras_per_surface =
      options.cameras_per_surface > 0 ? options.cameras_per_surface : cameras_within_budget(ranks, options.budget);

  std::vector<ObjectTransforms> to_round;
  to_round.reserve(views.size());
  for (const InputView* view : views) to_round.push_back(round_from_view(view->objects, round_objects));
  for (const ViewSurface& surface : surfaces) {
    round.dropped.push_back(surface.dropped);
    for (const float footprint : surface.footprint_m) round.valid += footprint > 0 ? 1 : 0;
  }
  const Survivors survivors = survivors_of(views, surfaces, ranks, round.cameras_per_surface, to_round);
  const std::vector<std::uint32_t> kept = thin_to_budget(survivors.position, survivors.area_m2, options.budget);
  round.culled = round.valid - survivors.source.size();
  round.thinned = survivors.source.size() - kept.size();

  // The mean area that a kept sample stands for has grown by what thinning took away.
  const float thinning =
      kept.empty() ? 1.0F : std::sqrt(static_cast<float>(survivors.source.size()) / static_cast<float>(kept.size()));
  SampleSet& samples = round.samples;
  samples.resize(kept.size());
  std::vector<float> fallback_m(kept.size());
  tbb::parallel_for(std::size_t{0}, kept.size(), [&](std::size_t k) {
    const Source source = survivors.source[kept[k]];
    const InputView& view = *views[source.view];
    const ViewSurface& surface = surfaces[source.view];
    const std::size_t i = source.pixel;
    samples.position[k] = survivors.position[kept[k]];
    samples.normal[k] = glm::normalize(glm::vec3(view.normal[i]));
    const auto moved = to_round[source.view].find(surface.object_id[i]);
    if (moved != to_round[source.view].end()) samples.normal[k] = moved->second.rotation * samples.normal[k];
    samples.color[k] = without_background(linear(view.color[i]), view.color[i][3], view.light.background);
    samples.albedo[k] = without_background(linear(view.albedo[i]), view.albedo[i][3], glm::vec3(0));
    samples.footprint_m[k] = surface.footprint_m[i];
    samples.cosine[k] = surface.cosine[i];
    samples.object_id[k] = surface.object_id[i];
    samples.camera[k] = source.view;
    fallback_m[k] = std::sqrt(survivors.area_m2[kept[k]]) * thinning;
  });
  samples.spacing_m = estimate_spacing(samples.position, samples.normal, fallback_m);
  round.depth_m.reserve(surfaces.size());
  for (ViewSurface& surface : surfaces) round.depth_m.push_back(std::move(surface.depth_m));
  return round;
}

}  // namespace splatbus::capture_bridge
