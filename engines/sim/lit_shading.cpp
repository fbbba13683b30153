#include "sim/lit_shading.h"

#include <array>
#include <glm/gtc/constants.hpp>
#include <glm/gtc/type_ptr.hpp>

namespace splatbus::sim {
namespace {

/// Coefficients of the SH polynomials in n, with the basis constants and the clamped-cosine factors over pi (1, 2/3,
/// 1/4) in.
std::array<glm::vec3, 9> ambient_polynomial(const splatbus_light& light) {
  constexpr std::array<float, 9> kFactors{0.28209479F,         0.48860251F * 2 / 3, 0.48860251F * 2 / 3,
                                          0.48860251F * 2 / 3, 1.0925484F / 4,      1.0925484F / 4,
                                          0.31539157F / 4,     1.0925484F / 4,      0.54627422F / 4};
  std::array<glm::vec3, 9> result{};
  for (std::size_t k = 0; k < 9; ++k) {
    for (std::size_t c = 0; c < 3; ++c) {
      result.at(k)[static_cast<int>(c)] = kFactors.at(k) * light.ambient_sh[9 * c + k];
    }
  }
  return result;
}

}  // namespace

LitShading::LitShading(const LitShadingOptions& options, const Scene& scene)
    : softness_m_(options.softness_m),
      sun_(options.sun_map_size, scene.bounds(true), scene.bounds(false)),
      sources_(options.source_map_size, options.sun_map_size, scene.bounds(false)) {}

void LitShading::update(GpuScene& scene, const splatbus_light& light, const glm::vec3& eye,
                        const DepthPrograms& program_for) {
  sun_.update(scene, light, eye, program_for);
  has_sources_ = light.source_count > 0;
  if (has_sources_) sources_.update(scene, light, program_for);
}

ShaderVariant LitShading::variant(const ShaderVariant& shade) const {
  ShaderVariant result = shade;
  result.cascades = sun_.cascades();
  result.sources = has_sources_;
  return result;
}

void LitShading::bind(GLuint program, const splatbus_light& light) const {
  glm::vec3 sun_over_pi{light.sun_irradiance[0], light.sun_irradiance[1], light.sun_irradiance[2]};
  sun_over_pi /= glm::pi<float>();
  glProgramUniform3fv(program, kSunDirection, 1, light.sun_direction);
  glProgramUniform3fv(program, kSunOverPi, 1, glm::value_ptr(sun_over_pi));
  glProgramUniform3fv(program, kAmbientReflected, 9, glm::value_ptr(ambient_polynomial(light).front()));
  sun_.bind(program, softness_m_);
  if (sun_.cascades() || has_sources_) glProgramUniform1f(program, kSoftness, softness_m_);
  if (has_sources_) sources_.bind();
}

}  // namespace splatbus::sim
