#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <vector>

#include "gaussians/light.h"
#include "gaussians/model.h"
#include "gaussians/sh.h"
#include "splats/splat.h"

namespace splatbus::splats {

/// What a model shows at one instant, Gaussian by Gaussian, for files that know neither lights nor objects: transforms
/// are applied, and Transfer is shaded under the light into SH of degree 0. The far field is about the origin, as other
/// programs have no frame that goes with the camera.
///
/// Left out are Gaussians of objects that the scene has no transform of, which are hidden, and those that are not
/// finite: a live model may hold one that training has just spoilt.
///
/// Reads `gaussians`, which has no pages (GaussiansBuffer::copy_of() takes them away), as long as it lives: parameters,
/// object_id, normal (may be null for Radiance) and visibility. Any number of threads may read it.
class BakedModel {
 public:
  BakedModel(const GaussiansView& gaussians, const SceneState& scene);

  [[nodiscard]] std::size_t count() const { return shown_.size(); }
  [[nodiscard]] int sh_degree() const;
  [[nodiscard]] int sh_coefficients() const { return (sh_degree() + 1) * (sh_degree() + 1); }
  [[nodiscard]] Splat operator[](std::size_t i) const;

 private:
  /// What all Gaussians of one object share.
  struct ObjectFrame {
    ObjectTransform world_from_object;
    bool moved = false;
    Light light;               // in the object's frame
    ShRotation sh_rotation{};  // world from object
  };
  void add_frame(std::uint32_t id, const ObjectTransform& world_from_object, const Light& light);
  [[nodiscard]] std::uint32_t object_of(std::size_t i) const;

  GaussiansView gaussians_;
  std::map<std::uint32_t, ObjectFrame> frames_;
  std::vector<std::uint32_t> shown_;  ///< indices
};

}  // namespace splatbus::splats
