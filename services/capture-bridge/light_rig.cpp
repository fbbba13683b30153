#include "capture-bridge/light_rig.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace splatbus::capture_bridge {

namespace {

constexpr std::uint32_t kFaces = 6;
constexpr float kCascadeFactor = 4;
// A cascade pays where its texels are well below the whole scene's; between the two bounds what is stays.
constexpr float kWorthwhile = 0.65F, kUseless = 0.8F;  // of the whole scene's side
constexpr float kDrift = 0.125F;                       // of a cascade's side

// The engine puts light cameras where lights are. What the request says besides only has to be sound.
constexpr float kSceneExtent_m = 12, kHeight_m = 20;

constexpr float kLeastExtent_m = 1e-3F, kMostExtent_m = 1e6F;
constexpr float kMostApart_m = 0.01F;
constexpr float kLeastCosine = 0.999F;

const LightSource* find(const Light& light, std::uint32_t id) {
  const auto found = std::ranges::find_if(light.sources, [id](const LightSource& source) { return source.id == id; });
  return found == light.sources.end() ? nullptr : &*found;
}

CameraRequest map_request(std::uint32_t slot, std::uint32_t camera, std::uint32_t size) {
  CameraRequest request{.camera = look_at({0, kHeight_m, 0}, {0, 0, 0}, size, size, 1),
                        .buffers = wire::EngineBuffer::LightDepth};
  request.camera.id = slot * kMaxLightMaps + camera;
  request.camera.role = CameraRole::Light;
  request.camera.fx = request.camera.fy = static_cast<float>(size) / kSceneExtent_m;
  request.camera.far_m = 2 * kHeight_m;
  return request;
}

}  // namespace

std::uint32_t LightRig::maps_with(std::uint32_t light_id, std::uint32_t light_map, std::uint32_t camera_id) const {
  const auto found = of_light_.find(light_id);
  if (found == of_light_.end() || light_map >= found->second.maps) return 0;
  const Known& light = found->second;
  return camera_id == light.slot * kMaxLightMaps + camera_of(light, light_map) ? light.maps : 0;
}

std::vector<std::uint32_t> LightRig::missing() const {
  std::vector<std::uint32_t> ids;
  for (const auto& [light_id, light] : of_light_) {
    for (std::uint32_t camera = 0; camera < light.maps; ++camera) {
      if ((light.seen >> camera & 1U) == 0) ids.push_back(light.slot * kMaxLightMaps + camera);
    }
  }
  return ids;
}

std::uint32_t LightRig::camera_of(const Known& light, std::uint32_t light_map) {
  return light.orthographic ? (light_map + 1) % light.maps : light_map;
}

void LightRig::saw(std::uint32_t light_id, std::uint32_t light_map, const Camera& camera) {
  const auto found = of_light_.find(light_id);
  if (found == of_light_.end()) return;
  found->second.seen |= 1U << camera_of(found->second, light_map);
  if (!found->second.orthographic || light_map + 1 != found->second.maps) return;
  found->second.scene_m =
      std::max(static_cast<float>(camera.width) / camera.fx, static_cast<float>(camera.height) / camera.fy);
}

void LightRig::forget_others(const Light& light) {
  std::erase_if(of_light_, [&](const auto& entry) {
    if (entry.first == 0) return false;
    const LightSource* const source = find(light, entry.first);
    return source == nullptr || !source->casts_shadow ||
           (source->kind == LightKind::Directional) != entry.second.orthographic;
  });
}

LightRig::Known& LightRig::known(std::uint32_t light_id) {
  const auto [place, is_new] = of_light_.try_emplace(light_id);
  if (!is_new) return place->second;
  std::uint32_t slot = 0;
  const auto taken = [&](const auto& entry) { return entry.first != light_id && entry.second.slot == slot; };
  while (std::ranges::any_of(of_light_, taken)) ++slot;
  place->second.slot = slot;
  return place->second;
}

void LightRig::place_cascades(const LightRigOptions& options, const glm::vec3& centre, Known& light) const {
  std::size_t finer = 0;
  float extent_m = options.extent_m;
  for (; finer + 1 < std::min(options.cascades, kMaxLightMaps); ++finer, extent_m *= kCascadeFactor) {
    const bool there = finer < light.centre.size();
    if (!(extent_m < (there ? kUseless : kWorthwhile) * light.scene_m)) break;
    if (!there) light.centre.push_back(centre);
    if (glm::distance(light.centre[finer], centre) > kDrift * extent_m) light.centre[finer] = centre;
  }
  light.centre.resize(finer);
}

std::vector<CameraRequest> LightRig::requests(const LightRigOptions& options, const Light& light,
                                              const glm::vec3& centre) {
  forget_others(light);
  std::vector<CameraRequest> all;
  const auto ask_for = [&](std::uint32_t light_id, LightKind kind) {
    Known& of = known(light_id);
    of.orthographic = kind == LightKind::Directional;
    const auto add = [&](CameraRequest request, std::uint32_t light_map) {
      request.light_id = light_id;
      request.light_map = light_map;
      all.push_back(request);
    };
    if (!of.orthographic) {
      of.maps = kind == LightKind::Point ? kFaces : 1;
      for (std::uint32_t map = 0; map < of.maps; ++map) add(map_request(of.slot, map, options.source_size), map);
      return;
    }
    place_cascades(options, centre, of);
    of.maps = static_cast<std::uint32_t>(of.centre.size()) + 1;
    float extent_m = options.extent_m;
    for (std::uint32_t map = 0; map + 1 < of.maps; ++map, extent_m *= kCascadeFactor) {
      CameraRequest request = map_request(of.slot, 1 + map, options.depth_size);
      request.camera.world_from_camera.translation = of.centre[map];
      request.camera.fx = request.camera.fy = static_cast<float>(options.depth_size) / extent_m;
      request.extent_m = extent_m;
      add(request, map);
    }
    add(map_request(of.slot, 0, options.depth_size), of.maps - 1);
  };
  ask_for(0, LightKind::Directional);
  for (const LightSource& source : light.sources) {
    if (source.casts_shadow) ask_for(source.id, source.kind);
  }
  return all;
}

std::string fault_of(const Light& light, std::uint32_t light_id, std::uint32_t light_map, const Camera& camera) {
  const LightSource* const source = find(light, light_id);
  if (light_id != 0 && source == nullptr) return fmt::format("its scene has no light {}", light_id);
  if (source != nullptr && !source->casts_shadow) return fmt::format("light {} casts no shadow", light_id);
  const auto degenerate = [&](const std::string& why) {
    return fmt::format("camera of light {}, map {}, is degenerate: {}", light_id, light_map, why);
  };
  const glm::vec3 axis = camera.world_from_camera.rotation * glm::vec3(0, 0, 1);
  const bool is_dark = source == nullptr && light.sun_irradiance == glm::vec3(0);  // and has no direction
  const glm::vec3 shines = source == nullptr                        ? -light.sun_direction
                           : source->kind == LightKind::Directional ? -source->direction
                                                                    : source->direction;
  const bool has_direction = !is_dark && (source == nullptr || source->kind != LightKind::Point);
  if (has_direction && !(glm::dot(axis, shines) >= kLeastCosine)) {
    return degenerate("it does not look where the light shines");
  }
  if (source == nullptr || source->kind == LightKind::Directional) {
    const float width_m = static_cast<float>(camera.width) / camera.fx;
    const float height_m = static_cast<float>(camera.height) / camera.fy;
    const bool sound = std::min(width_m, height_m) >= kLeastExtent_m && std::max(width_m, height_m) <= kMostExtent_m;
    return sound ? "" : degenerate(fmt::format("it covers {} x {} m", width_m, height_m));
  }
  const float apart_m = glm::distance(camera.world_from_camera.translation, source->position);
  if (!(apart_m <= kMostApart_m)) return degenerate(fmt::format("it stands {} m from the light", apart_m));
  if (!(camera.near_m > 0)) return degenerate("a pinhole whose near plane is at 0");
  return "";
}

}  // namespace splatbus::capture_bridge
