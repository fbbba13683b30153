#pragma once

#include "device/stream.h"
#include "gaussians/model.h"

namespace splatbus::bus {
class ParameterBinder;
}  // namespace splatbus::bus

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

/// Share of the sun's disc that each Gaussian's surface point sees, 255 for all of it: percentage-closer filtering
/// (Reeves et al. 1987) under a paraboloid, every texel compared with the depth of the surface's own plane there
/// (receiver plane bias, Isidoro 2006), so that slanted surfaces do not shade themselves. What faces away from the
/// light is 0, what lies outside of the map 1.
///
/// Reads surface_point, normal, the scales, and object_id or, of a model in pages, the ranges' frame_id. `visibility`
/// has gaussians.count entries, one an index; those that are no Gaussian's hold anything. What Gaussians and map point
/// to, and `visibility`, lie in memory of the stream's device; the ranges on the host. Waits for the result. Throws
/// std::runtime_error when the device fails.
void compute_visibility(device::StreamView stream, const GaussiansView& gaussians, const ObjectTransforms& objects,
                        const LightDepthMap& map, const VisibilityOptions& options, std::uint8_t* visibility);

}  // namespace splatbus::relight
