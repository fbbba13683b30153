#include "sim/scene.h"

#include <algorithm>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <utility>

namespace splatbus::sim {

glm::mat4 matrix(const Pose& world_from_object) {
  glm::mat4 result(world_from_object.scale * glm::mat3_cast(world_from_object.rotation));
  result[3] = glm::vec4(world_from_object.translation, 1);
  return result;
}

Pose operator*(const Pose& a, const Pose& b) {
  return {a.rotation * b.rotation, a.rotation * (a.scale * b.translation) + a.translation, a.scale * b.scale};
}

Object& Scene::add(std::string name, Mesh mesh, Image image, const glm::mat4& world_from_object) {
  materials.push_back({.image = static_cast<int>(images.size())});
  images.push_back(std::move(image));
  return add(std::move(name), std::move(mesh), static_cast<int>(materials.size()) - 1, world_from_object);
}

Object& Scene::add(std::string name, Mesh mesh, int material, const glm::mat4& world_from_object) {
  Object object;
  object.id = static_cast<std::uint32_t>(objects.size() + 1);
  object.name = std::move(name);
  object.world_from_object = world_from_object;
  object.parts.push_back({.mesh = std::move(mesh), .material = material});
  objects.push_back(std::move(object));
  return objects.back();
}

std::size_t Scene::triangle_count() const {
  std::size_t count = 0;
  for (const Object& object : objects) {
    for (const Part& part : object.parts) count += part.mesh.indices.size() / 3;
  }
  return count;
}

Bounds Scene::bounds(bool shadow_casters_only) const {
  Bounds result;
  for (const Object& object : objects) {
    if (!(shadow_casters_only ? object.casts_shadow : object.in_light_depth())) continue;
    Bounds local;
    for (const Part& part : object.parts) local.add(bounds_of(part.mesh));
    if (!object.motion) {
      result.add(transformed(local, object.world_from_object));
      continue;
    }
    // Turned in any way, it keeps within a ball.
    const glm::vec3 reach(object.greatest_scale * glm::length(glm::max(glm::abs(local.low), glm::abs(local.high))));
    result.add(object.motion_origins.low - reach);
    result.add(object.motion_origins.high + reach);
  }
  return result;
}

splatbus_light Lighting::at(double time_s) const {
  splatbus_light light = ambient;
  const double azimuth = glm::radians(sun_azimuth_deg + sun_rate_deg_s * time_s);
  const double zenith = glm::radians(sun_zenith_deg);
  light.sun_direction[0] = static_cast<float>(std::sin(zenith) * std::cos(azimuth));
  light.sun_direction[1] = static_cast<float>(std::cos(zenith));
  light.sun_direction[2] = static_cast<float>(std::sin(zenith) * std::sin(azimuth));
  for (int c = 0; c < 3; ++c) light.sun_irradiance[c] = night ? 0 : sun_irradiance[c];
  if (!night) return light;
  constexpr float kFaint = 0.03F;
  for (float& coefficient : light.ambient_sh) coefficient *= kFaint;
  for (float& channel : light.background) channel *= kFaint;
  return light;
}

std::vector<splatbus_light_source> Lighting::sources_at(double time_s) const {
  std::vector<splatbus_light_source> result;
  for (std::size_t i = 0; i < std::min(sources.size(), sources_on); ++i) {
    std::optional<splatbus_light_source> source = sources[i].at(time_s);
    if (!source) continue;
    source->id = sources[i].id;
    source->depth_version = 0;
    result.push_back(*source);
  }
  std::ranges::sort(result, {}, &splatbus_light_source::id);
  return result;
}

splatbus_light Lighting::sky() {
  // Real SH, signs as in 3DGS: Y00 = 0.2820948, Y1 = 0.4886025 (-y, z, -x), Y2,2 = 0.5462742 (x^2 - y^2), ... A bluish
  // sky above a warm ground, a little brighter towards +x and +z.
  constexpr glm::vec3 kMean{0.25F, 0.27F, 0.31F};
  constexpr glm::vec3 kFromAbove{0.13F, 0.17F, 0.24F};
  constexpr glm::vec3 kFromSide{0.05F, 0.04F, 0.03F};
  constexpr glm::vec3 kZonal{0.02F, 0.02F, 0.03F};
  splatbus_light light{};
  for (int c = 0; c < 3; ++c) {
    float* sh = light.ambient_sh + std::ptrdiff_t{9} * c;
    sh[0] = kMean[c] / 0.2820948F;
    sh[1] = -kFromAbove[c] / 0.4886025F;
    sh[2] = kFromSide[c] / 0.4886025F;
    sh[3] = -kFromSide[c] / 0.4886025F;
    sh[6] = -kZonal[c] / 0.3153916F;
    sh[8] = -kZonal[c] / 0.5462742F;
  }
  constexpr glm::vec3 kBackground{0.40F, 0.55F, 0.75F};
  for (int c = 0; c < 3; ++c) light.background[c] = kBackground[c];
  return light;
}

}  // namespace splatbus::sim
