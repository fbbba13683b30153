#pragma once

#include <span>

#include "bus/parameters.h"
#include "gaussians/model.h"

namespace splatbus::relight {

/// The scene as the sun sees it: an orthographic camera of role Light and depth along its z, metres, [height][width].
struct LightDepthMap {
  Camera camera;
  const float* depth_m = nullptr;
};

struct VisibilityOptions {
  float softness_m = 0.012F;  ///< radius of the filter on the light's image plane
  float footprint = 0.5F;     ///< added to the radius, in standard deviations of the Gaussian
  float lift_texels = 1.0F;   ///< the tested point is raised along the normal, against what the map cannot resolve

  void bind(bus::ParameterBinder& parameters);
};

/// Share of the sun's disc that each Gaussian's surface point sees, in [0, 1]: percentage-closer filtering (Reeves et
/// al. 1987) under a paraboloid, every texel compared with the depth of the surface's own plane there (receiver plane
/// bias, Isidoro 2006), so that slanted surfaces do not shade themselves. What faces away from the light is 0, what
/// lies outside of the map 1.
///
/// Reads surface_point, normal, object_id and the scales; `visibility` has gaussians.count entries. Runs in parallel.
void compute_visibility(const GaussiansView& gaussians, const ObjectTransforms& objects, const LightDepthMap& map,
                        const VisibilityOptions& options, std::span<float> visibility);

}  // namespace splatbus::relight
