#include "gaussians/light.h"

#include <algorithm>
#include <cmath>

#include "gaussians/sh.h"

namespace splatbus {

Sh9 sh9_basis(const glm::vec3& unit_direction) {
  const float x = unit_direction.x, y = unit_direction.y, z = unit_direction.z;
  return {kShC0,
          -kShC1 * y,
          kShC1 * z,
          -kShC1 * x,
          kShC2[0] * x * y,
          kShC2[1] * y * z,
          kShC2[2] * (2 * z * z - x * x - y * y),
          kShC2[3] * x * z,
          kShC2[4] * (x * x - y * y)};
}

glm::vec3 ambient_reflected(const Light& light, const glm::vec3& normal_world) {
  constexpr Sh9 kClampedCosineOverPi = {1, 2.0F / 3, 2.0F / 3, 2.0F / 3, 0.25F, 0.25F, 0.25F, 0.25F, 0.25F};
  const Sh9 basis = sh9_basis(normal_world);
  glm::vec3 sum(0);
  for (std::size_t k = 0; k < basis.size(); ++k) sum += kClampedCosineOverPi[k] * basis[k] * light.ambient_sh[k];
  return sum;
}

std::array<glm::vec3, 9> rotate_sh9(const std::array<glm::vec3, 9>& coefficients, const glm::quat& rotation) {
  // Band 1 is a vector g with f = C1 g.d, band 2 a symmetric traceless matrix M with f = d^T M d: they rotate to R g
  // and R M R^T.
  const glm::mat3 r = glm::mat3_cast(rotation);
  std::array<glm::vec3, 9> out = coefficients;
  for (int channel = 0; channel < 3; ++channel) {
    const auto c = [&](std::size_t k) { return coefficients[k][channel]; };
    const glm::vec3 g = r * glm::vec3(-c(3), -c(1), c(2));
    out[1][channel] = -g.y;
    out[2][channel] = g.z;
    out[3][channel] = -g.x;

    const float xy = 0.5F * kShC2[0] * c(4), yz = 0.5F * kShC2[1] * c(5), xz = 0.5F * kShC2[3] * c(7);
    const float zonal = kShC2[2] * c(6), difference = kShC2[4] * c(8);
    const glm::mat3 m(difference - zonal, xy, xz,   //
                      xy, -difference - zonal, yz,  //
                      xz, yz, 2 * zonal);
    const glm::mat3 rotated = r * m * glm::transpose(r);
    out[4][channel] = 2 * rotated[0][1] / kShC2[0];
    out[5][channel] = 2 * rotated[1][2] / kShC2[1];
    out[6][channel] = 0.5F * rotated[2][2] / kShC2[2];
    out[7][channel] = 2 * rotated[0][2] / kShC2[3];
    out[8][channel] = 0.5F * (rotated[0][0] - rotated[1][1]) / kShC2[4];
  }
  return out;
}

Incident incident(const LightSource& source, const glm::vec3& point) {
  if (source.kind == LightKind::Directional) return {source.direction, source.intensity};
  constexpr float kLeastDistance_m = 0.01F;
  const glm::vec3 way = source.position - point;
  const float distance_m = std::max(glm::length(way), kLeastDistance_m);
  const glm::vec3 to_light = way / distance_m;
  const float share = distance_m / source.range_m;
  const float window = std::clamp(1 - share * share * share * share, 0.0F, 1.0F);
  float factor = window * window / (distance_m * distance_m);
  if (source.kind == LightKind::Spot) {
    const float cosine = -glm::dot(to_light, source.direction);
    const float cone = std::clamp((cosine - source.cos_outer) / (source.cos_inner - source.cos_outer), 0.0F, 1.0F);
    factor *= cone * cone;
  }
  return {to_light, factor * source.intensity};
}

std::vector<std::uint32_t> light_ids(const Light& light) {
  std::vector<std::uint32_t> ids{0};
  for (const LightSource& source : light.sources) ids.push_back(source.id);
  return ids;
}

glm::vec3 operator*(const ObjectTransform& world_from_object, const glm::vec3& point_object) {
  return world_from_object.rigid * (world_from_object.scale * point_object);
}

glm::vec3 object_point(const ObjectTransform& world_from_object, const glm::vec3& point_world) {
  return inverse(world_from_object.rigid) * point_world / world_from_object.scale;
}

ObjectTransform far_field() {
  ObjectTransform transform;
  transform.emissive = true;
  return transform;
}

ObjectTransform seen_from(const glm::vec3& eye_world, std::uint32_t object_id,
                          const ObjectTransform& world_from_object) {
  if (object_id != kFarFieldFrame) return world_from_object;
  ObjectTransform seen = far_field();
  seen.scale = kFarFieldDistance_m / kFarFieldRadius;
  seen.rigid.translation = eye_world - seen.scale * kFarFieldCentre;
  return seen;
}

Light light_in_object(const Light& light, const ObjectTransform& world_from_object) {
  if (world_from_object.emissive) {
    Light white{.generation = light.generation, .background = light.background, .sources = {}};
    white.ambient_sh[0] = glm::vec3(1 / kShC0);
    return white;
  }
  const glm::quat object_from_world = glm::conjugate(world_from_object.rigid.rotation);
  Light out = light;
  out.ambient_sh = rotate_sh9(light.ambient_sh, object_from_world);
  out.sun_direction = object_from_world * light.sun_direction;
  const float scale = world_from_object.scale;
  for (LightSource& source : out.sources) {
    source.position = object_point(world_from_object, source.position);
    source.direction = object_from_world * source.direction;
    if (source.kind == LightKind::Directional) continue;
    source.range_m /= scale;
    source.intensity /= scale * scale;
  }
  return out;
}

float srgb_from_linear(float linear) {
  const float x = std::clamp(linear, 0.0F, 1.0F);
  return x <= 0.0031308F ? 12.92F * x : 1.055F * std::pow(x, 1 / 2.4F) - 0.055F;
}

float linear_from_srgb(float srgb) {
  const float x = std::clamp(srgb, 0.0F, 1.0F);
  return x <= 0.04045F ? x / 12.92F : std::pow((x + 0.055F) / 1.055F, 2.4F);
}

}  // namespace splatbus
