#include "sim/depth_versions.h"

#include <algorithm>
#include <array>
#include <glm/glm.hpp>
#include <iterator>
#include <set>

#include "sim/light_maps.h"
#include "sim/projection.h"

namespace splatbus::sim {
namespace {

bool same_maps(const splatbus_light_source& a, const splatbus_light_source& b) {
  const auto values = [](const splatbus_light_source& s) {
    return std::array{s.position[0],  s.position[1],  s.position[2], s.direction[0],
                      s.direction[1], s.direction[2], s.range_m,     s.cos_outer};
  };
  return a.kind == b.kind && a.casts_shadow == b.casts_shadow && values(a) == values(b);
}

bool reaches(const splatbus_light_source& source, const Bounds& bounds) {
  if (source.kind == SPLATBUS_LIGHT_DIRECTIONAL) return true;
  const glm::vec3 eye{source.position[0], source.position[1], source.position[2]};
  if (glm::distance(eye, glm::clamp(eye, bounds.low, bounds.high)) > source.range_m) return false;
  if (source.kind == SPLATBUS_LIGHT_POINT) return true;
  constexpr std::uint32_t kCoarse = 64;  // its margin is wider than that of any finer map
  const splatbus_camera cone = spot_camera(source, kCoarse, kCoarse);
  return Frustum(clip_from_camera(cone, Projection::Pinhole) * camera_from_world(cone)).may_show(bounds);
}

}  // namespace

void DepthVersions::update(splatbus_light& light, std::span<splatbus_light_source> sources,
                           std::span<const Bounds> moved) {
  const bool rests = std::equal(std::begin(sun_direction_), std::end(sun_direction_), std::begin(light.sun_direction));
  if (!rests || !moved.empty() || sun_version_ == 0) ++sun_version_;
  std::ranges::copy(light.sun_direction, std::begin(sun_direction_));
  light.sun_depth_version = sun_version_;

  std::set<std::uint32_t> there;
  for (splatbus_light_source& source : sources) {
    there.insert(source.id);
    Known& known = sources_[source.id];
    const bool same = known.exists && same_maps(known.source, source) &&
                      std::ranges::none_of(moved, [&](const Bounds& bounds) { return reaches(source, bounds); });
    if (!same) ++known.version;
    known.exists = true;
    known.source = source;
    source.depth_version = known.version;
  }
  for (auto& [id, known] : sources_) known.exists = there.contains(id);
}

}  // namespace splatbus::sim
