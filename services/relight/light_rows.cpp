#include "relight/light_rows.h"

#include <algorithm>
#include <utility>

namespace splatbus::relight {

namespace {

/// Whether the two are seen by the same surfaces, given the same depth maps.
bool same_reach(const LightSource& a, const LightSource& b) {
  return a.id == b.id && a.kind == b.kind && a.casts_shadow == b.casts_shadow && a.position == b.position &&
         a.direction == b.direction && a.range_m == b.range_m && a.cos_outer == b.cos_outer;
}

bool is_fresh(std::uint64_t computed_step, std::uint64_t step) {
  return step >= computed_step && 4 * (step - computed_step) <= step;
}

}  // namespace

std::optional<std::vector<LightOfScene>> find_lights(const Light& light, const MapRing& maps) {
  std::vector<LightOfScene> lights{{sun_source(light), nullptr}};
  for (const LightSource& source : light.sources) lights.push_back({source, nullptr});
  for (LightOfScene& of_scene : lights) {
    if (!of_scene.source.casts_shadow) continue;
    of_scene.maps = maps.find(of_scene.source.id, of_scene.source.depth_version);
    if (!of_scene.maps) return {};
  }
  return lights;
}

std::vector<MappedLight> mapped(std::span<const LightOfScene> lights) {
  std::vector<MappedLight> out;
  out.reserve(lights.size());
  for (const LightOfScene& light : lights) {
    MappedLight& mapped = out.emplace_back(MappedLight{.source = light.source, .maps = {}});
    if (!light.maps) continue;
    for (const LightMaps::Map& map : light.maps->maps) {
      mapped.maps.push_back({.camera = map.camera, .depth_m = reinterpret_cast<const float*>(map.depth_m.get())});
    }
  }
  return out;
}

std::int32_t LightRows::row_before(const Row& row) const {
  const auto found = std::ranges::find_if(before_.rows, [&](const Row& candidate) {
    return candidate.maps_revision == row.maps_revision && same_reach(candidate.source, row.source);
  });
  return found == before_.rows.end() ? -1 : static_cast<std::int32_t>(found - before_.rows.begin());
}

const std::uint8_t* LightRows::compute(const PagedModel& model, const ObjectTransforms& objects,
                                       std::span<const LightOfScene> lights, const VisibilityOptions& options) {
  const GaussiansView& gaussians = model.gaussians;
  std::swap(now_, before_);
  if (before_.options != options) before_.rows.clear();
  const std::size_t page_count = gaussians.count == 0 ? 0 : ((gaussians.count - 1) >> gaussians.page_shift) + 1;
  now_.count = gaussians.count;
  now_.options = options;
  now_.pages.assign(page_count, {});
  now_.rows.clear();
  std::vector<std::int32_t> row_before_of;
  for (const LightOfScene& light : lights) {
    now_.rows.push_back({light.source, light.maps ? light.maps->revision : 0, {}});
    now_.rows.back().step.assign(page_count, model.step);
    row_before_of.push_back(row_before(now_.rows.back()));
  }
  std::vector<std::uint64_t> kept_of_page(page_count, 0);
  for (std::size_t k = 0; k < gaussians.ranges.size(); ++k) {
    const IndexRange& range = gaussians.ranges[k];
    const std::size_t page = range.first >> gaussians.page_shift;
    const auto object = objects.find(range.frame_id);
    now_.pages[page] = {model.page_generations[k],
                        object != objects.end() ? std::optional(object->second) : std::nullopt};
    const bool unmoved = page < before_.pages.size() && before_.pages[page] == now_.pages[page];
    for (std::size_t light = 0; light < lights.size(); ++light) {
      const std::int32_t row = row_before_of[light];
      const bool keep =
          unmoved && row >= 0 && is_fresh(before_.rows[static_cast<std::size_t>(row)].step[page], model.step);
      ++(keep ? skipped_ : computed_);
      if (!keep) continue;
      kept_of_page[page] |= std::uint64_t{1} << light;
      now_.rows[light].step[page] = before_.rows[static_cast<std::size_t>(row)].step[page];
    }
  }
  now_.values.resize(lights.size() * gaussians.count);
  compute_visibility(
      stream_, gaussians, objects, mapped(lights), options, now_.values.data(),
      {.values = before_.values.data(), .stride = before_.count, .row = row_before_of, .lights_of_page = kept_of_page});
  return now_.values.data();
}

void LightRows::forget() {
  now_.pages.clear();
  now_.rows.clear();
}

}  // namespace splatbus::relight
