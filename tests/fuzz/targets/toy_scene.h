#pragma once

#include "gaussians/light.h"

namespace splatbus::fuzz {

/// A sun, a lamp and two objects, in another place at each version.
inline SceneState toy_scene(std::uint64_t version) {
  const auto turn = static_cast<float>(version);
  SceneState scene;
  scene.version = version;
  scene.light.generation = version;
  scene.light.sun_direction = {0, 1, 0};
  scene.light.sun_irradiance = {3, 2.5F, 2};
  LightSource lamp;
  lamp.id = 4;
  lamp.kind = LightKind::Spot;
  lamp.position = {turn, 2, 0};
  lamp.direction = {0, -1, 0};
  lamp.intensity = {10, 9, 8};
  lamp.range_m = 6;
  lamp.cos_inner = 0.9F;
  lamp.cos_outer = 0.7F;
  scene.light.sources.push_back(lamp);
  for (const std::uint32_t id : {3U, 7U}) {
    scene.objects[id].rigid.translation = {static_cast<float>(id), 0.1F * turn, 0};
  }
  return scene;
}

}  // namespace splatbus::fuzz
