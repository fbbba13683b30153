#include "splats/baked_model.h"

#include <cassert>
#include <cmath>

#include "gaussians/transfer.h"

namespace splatbus::splats {

namespace {

bool is_finite(const GaussiansView& gaussians, std::size_t i) {
  float sum = 0, rotation = 0;  // each term is 0 or NaN, which stays
  for (int c = 0; c < gaussians.layout.channels(); ++c) sum += 0 * gaussians.plane(c)[i];
  for (int k = 0; k < 4; ++k) {
    const float q = gaussians.plane(ParameterLayout::kRotation + k)[i];
    rotation += q * q;
  }
  for (std::size_t axis = 0; axis < 3 && gaussians.normal != nullptr; ++axis) {
    sum += 0 * gaussians.normal[axis * gaussians.stride + i];
  }
  if (gaussians.visibility != nullptr) sum += 0 * gaussians.visibility[i];
  return sum == 0 && rotation > 0 && std::isfinite(rotation);
}

}  // namespace

BakedModel::BakedModel(const GaussiansView& gaussians, const SceneState& scene) : gaussians_(gaussians) {
  assert(!gaussians.has_pages());
  frames_.emplace(kWorldFrame, ObjectFrame{.light = scene.light});
  for (const auto& [id, world_from_object] : scene.objects) add_frame(id, world_from_object, scene.light);
  add_frame(kFarFieldFrame, seen_from(glm::vec3(0), kFarFieldFrame, {}), scene.light);
  shown_.reserve(gaussians.count);
  for (std::size_t i = 0; i < gaussians.count; ++i) {
    if (frames_.contains(object_of(i)) && is_finite(gaussians, i)) shown_.push_back(static_cast<std::uint32_t>(i));
  }
}

void BakedModel::add_frame(std::uint32_t id, const ObjectTransform& world_from_object, const Light& light) {
  frames_.insert_or_assign(id, ObjectFrame{world_from_object, true, light_in_object(light, world_from_object),
                                           sh_rotation(world_from_object.rigid.rotation)});
}

std::uint32_t BakedModel::object_of(std::size_t i) const {
  return gaussians_.object_id != nullptr ? gaussians_.object_id[i] : kWorldFrame;
}

int BakedModel::sh_degree() const {
  return gaussians_.layout.appearance == Appearance::Transfer ? 0 : gaussians_.layout.sh_degree;
}

Splat BakedModel::operator[](std::size_t i) const {
  const std::size_t index = shown_[i];
  const ObjectFrame& frame = frames_.at(object_of(index));
  const bool transfer = gaussians_.layout.appearance == Appearance::Transfer;
  GaussiansView geometry = gaussians_;
  if (transfer) geometry.layout = {Appearance::Radiance, 0};  // which has no more of it than load() reads
  Splat splat = load(geometry, index);
  if (transfer) {
    const glm::vec3 color = shade_transfer(gaussians_, index, frame.light);
    for (int c = 0; c < 3; ++c) splat.sh[0][c] = (srgb_from_linear(color[c]) - 0.5F) / kShC0;
  }
  if (!frame.moved) return splat;
  const ObjectTransform& world_from_object = frame.world_from_object;
  splat.mean = world_from_object * splat.mean;
  splat.normal = world_from_object.rigid.rotation * splat.normal;
  splat.log_scale += std::log(world_from_object.scale);
  splat.rotation = world_from_object.rigid.rotation * splat.rotation;
  const auto local = splat.sh;
  const auto coefficients = static_cast<std::size_t>(sh_coefficients());
  for (std::size_t k = 1; k < coefficients; ++k) {
    splat.sh[k] = glm::vec3(0);
    for (std::size_t j = 1; j < coefficients; ++j) splat.sh[k] += frame.sh_rotation[k][j] * local[j];
  }
  return splat;
}

}  // namespace splatbus::splats
