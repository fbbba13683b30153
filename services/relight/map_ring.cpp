#include "relight/map_ring.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>
#include <utility>

#include "wire/convert.h"
#include "wire/scene_generated.h"

namespace splatbus::relight {

namespace {

/// Whether a map through b shows what one through a shows: the planes only say how far it reaches.
bool same_projection(const Camera& a, const Camera& b) {
  return a.width == b.width && a.height == b.height && a.fx == b.fx && a.fy == b.fy && a.cx == b.cx && a.cy == b.cy &&
         a.world_from_camera == b.world_from_camera;
}

}  // namespace

MapRing::Key MapRing::key_of(const wire::SceneLightDepth& depth) {
  const Light light = from_wire(*depth.scene()->light());
  const auto source = std::ranges::find(light.sources, depth.light_id(), &LightSource::id);
  const bool sun = depth.light_id() == 0;
  if (!sun && (source == light.sources.end() || !source->casts_shadow)) {
    throw std::runtime_error(fmt::format("light {} is not one that casts a shadow", depth.light_id()));
  }
  if (depth.light_map() >= depth.light_maps() || depth.light_maps() > kMaxLightMaps) {
    throw std::runtime_error(fmt::format("map {} of {}", depth.light_map(), depth.light_maps()));
  }
  return {.light_id = depth.light_id(),
          .depth_version = sun ? light.sun_depth_version : source->depth_version,
          .light_map = depth.light_map(),
          .light_maps = depth.light_maps()};
}

bool LightMaps::complete() const {
  return std::ranges::all_of(maps, [](const Map& map) { return map.depth_m != nullptr; });
}

std::shared_ptr<const LightMaps> MapRing::newest_of(std::uint32_t light_id, std::uint64_t depth_version) const {
  const auto light = of_light_.find(light_id);
  if (light == of_light_.end()) return nullptr;
  const auto found =
      std::ranges::find_if(light->second, [&](const auto& maps) { return maps->depth_version == depth_version; });
  return found == light->second.end() ? nullptr : *found;
}

bool MapRing::holds(const Key& key, const Camera& camera) const {
  const auto maps = newest_of(key.light_id, key.depth_version);
  if (!maps || maps->maps.size() != key.light_maps) return false;
  const LightMaps::Map& map = maps->maps[key.light_map];
  return map.depth_m != nullptr && same_projection(map.camera, camera);
}

void MapRing::put(const Key& key, LightMaps::Map map, std::uint64_t scene_version) {
  const auto before = newest_of(key.light_id, key.depth_version);
  LightMaps now = before ? *before : LightMaps{.depth_version = key.depth_version};
  // Others that together are the light's: those before were of a request that is no more.
  if (now.maps.size() != key.light_maps) now.maps.assign(key.light_maps, {});
  now.maps[key.light_map] = std::move(map);
  now.scene_version = scene_version;
  now.revision = ++revision_;
  auto& ring = of_light_[key.light_id];
  std::erase(ring, before);
  ring.push_back(std::make_shared<const LightMaps>(std::move(now)));
  if (ring.size() > kMaxVersions) ring.pop_front();
}

std::shared_ptr<const LightMaps> MapRing::find(std::uint32_t light_id, std::uint64_t depth_version) const {
  auto maps = newest_of(light_id, depth_version);
  return maps && maps->complete() ? maps : nullptr;
}

bool MapRing::is_past(std::uint32_t light_id, std::uint64_t scene_version) const {
  const auto light = of_light_.find(light_id);
  return light != of_light_.end() && std::ranges::any_of(light->second, [&](const auto& maps) {
           return maps->scene_version > scene_version && maps->complete();
         });
}

void MapRing::keep(const Light& light) {
  std::erase_if(of_light_, [&](const auto& entry) {
    return entry.first != 0 &&
           std::ranges::none_of(light.sources, [&](const LightSource& source) { return source.id == entry.first; });
  });
}

}  // namespace splatbus::relight
