#include "splats/splat.h"

namespace splatbus::splats {

namespace {

glm::vec3 triple(const float* planes, std::size_t stride, std::size_t i) {
  return {planes[i], planes[stride + i], planes[2 * stride + i]};
}

}  // namespace

Splat load(const GaussiansView& radiance, std::size_t i) {
  const auto three = [&](int channel) { return triple(radiance.plane(channel), radiance.stride, i); };
  Splat splat;
  splat.mean = three(ParameterLayout::kMean);
  if (radiance.normal != nullptr) splat.normal = triple(radiance.normal, radiance.stride, i);
  splat.log_scale = three(ParameterLayout::kLogScale);
  const auto component = [&](int k) { return radiance.plane(ParameterLayout::kRotation + k)[i]; };
  splat.rotation = glm::normalize(glm::quat(component(0), component(1), component(2), component(3)));
  splat.opacity_logit = radiance.plane(ParameterLayout::kOpacityLogit)[i];
  for (int k = 0; k < radiance.layout.sh_coefficients(); ++k) {
    splat.sh[static_cast<std::size_t>(k)] = three(ParameterLayout::kAppearance + 3 * k);
  }
  return splat;
}

void store(const Splat& splat, GaussiansBuffer& radiance, std::size_t i) {
  const auto put = [&](std::vector<float>& planes, int first, const glm::vec3& value) {
    for (int axis = 0; axis < 3; ++axis) {
      planes[static_cast<std::size_t>(first + axis) * radiance.stride() + i] = value[axis];
    }
  };
  put(radiance.parameters, ParameterLayout::kMean, splat.mean);
  put(radiance.parameters, ParameterLayout::kLogScale, splat.log_scale);
  put(radiance.normal, 0, splat.normal);
  put(radiance.surface_point, 0, splat.mean);
  const std::array<float, 4> rotation = {splat.rotation.w, splat.rotation.x, splat.rotation.y, splat.rotation.z};
  for (std::size_t k = 0; k < 4; ++k) {
    radiance.parameters[(ParameterLayout::kRotation + k) * radiance.stride() + i] = rotation[k];
  }
  radiance.parameters[ParameterLayout::kOpacityLogit * radiance.stride() + i] = splat.opacity_logit;
  for (int k = 0; k < radiance.layout().sh_coefficients(); ++k) {
    put(radiance.parameters, ParameterLayout::kAppearance + 3 * k, splat.sh[static_cast<std::size_t>(k)]);
  }
  radiance.gaussian_id[i] = i;
}

}  // namespace splatbus::splats
