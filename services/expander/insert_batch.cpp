#include "expander/insert_batch.h"

#include <algorithm>
#include <cmath>
#include <glm/gtc/constants.hpp>

#include "bus/memory.h"

namespace splatbus::expander {

namespace {

float luminance(const glm::vec3& linear) {
  return glm::dot(linear, glm::vec3(0.2126F, 0.7152F, 0.0722F));
}

template <class Vector>
void put(float* planes, std::size_t count, std::size_t i, const Vector& value) {
  for (int c = 0; c < Vector::length(); ++c) planes[static_cast<std::size_t>(c) * count + i] = value[c];
}

}  // namespace

glm::quat rotation_to_normal(const glm::vec3& normal) {
  if (normal.z < -0.9999F) return {0, 1, 0, 0};  // half a turn about x: any axis across z would do
  return glm::normalize(glm::quat(1 + normal.z, -normal.y, normal.x, 0));
}

float guess_visibility(const glm::vec3& color, const glm::vec3& albedo, const glm::vec3& normal, const Light& light) {
  const float facing = std::max(0.0F, glm::dot(normal, light.sun_direction));
  const float sun = luminance(albedo * light.sun_irradiance) * facing / glm::pi<float>();
  if (sun < kLeastSunPart) return 1;
  const float ambient = luminance(albedo * glm::max(ambient_reflected(light, normal), 0.0F));
  return std::clamp((luminance(color) - ambient) / sun, 0.0F, 1.0F);
}

InsertBatch initial_gaussians(const InputSamples& samples, std::span<const Chosen> chosen,
                              const InitialOptions& options) {
  const std::size_t n = chosen.size();
  InsertBatch batch{.capture_ns = samples.capture_ns,
                    .objects = samples.objects,
                    .light = samples.light,
                    .count = n,
                    .memory = Device::Cpu,
                    .data = bus::allocate_memory(Device::Cpu, n * kInsertBytes)};
  const InsertPlanes planes = batch.planes();
  std::fill_n(planes.opacity_logit, n, std::log(options.opacity / (1 - options.opacity)));
  for (std::size_t i = 0; i < n; ++i) {
    const Chosen& sample = chosen[i];
    const std::size_t s = sample.sample;
    const float along = std::log(std::max(samples.spacing_m[s], kLeastSpacing_m) * options.scale);
    const glm::quat rotation = rotation_to_normal(sample.normal);
    put(planes.mean, n, i, sample.position);
    put(planes.log_scale, n, i, glm::vec3(along, along, along + std::log(options.flatness)));
    put(planes.rotation, n, i, glm::vec4(rotation.w, rotation.x, rotation.y, rotation.z));
    put(planes.albedo, n, i, samples.albedo[s]);
    put(planes.normal, n, i, sample.normal);
    planes.visibility[i] = guess_visibility(samples.color[s], samples.albedo[s], samples.normal[s], samples.light);
    planes.object_id[i] = samples.object_id[s];
    planes.cell[i] = sample.cell;
  }
  return batch;
}

}  // namespace splatbus::expander
