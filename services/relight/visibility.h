#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "device/stream.h"
#include "gaussians/model.h"

namespace splatbus::bus {
class ParameterBinder;
}  // namespace splatbus::bus

namespace splatbus::relight {

/// A part of the scene as a light sees it: a camera of role Light, orthographic of the sun and of directional lights,
/// and depth along its z, metres, [height][width].
struct LightDepthMap {
  Camera camera;
  const float* depth_m = nullptr;
};

/// A light and its depth maps by light_map, where it casts shadows.
struct MappedLight {
  LightSource source;
  std::vector<LightDepthMap> maps;
};

/// The sun as a source among the others, id 0. One that gives no light casts no shadow.
[[nodiscard]] LightSource sun_source(const Light& light);

struct VisibilityOptions {
  float softness_m = 0.012F;  ///< radius of the filter on the light's image plane
  float footprint = 0.25F;    ///< added to the radius, in standard deviations of the Gaussian
  float lift_texels = 1.0F;   ///< the tested point is raised along the normal, against what the map cannot resolve

  void bind(bus::ParameterBinder& parameters);
  bool operator==(const VisibilityOptions&) const = default;
};

/// Which of an earlier result still holds: of light j it is row[j] of `values`, for the Gaussians of each page that has
/// bit j set in lights_of_page; -1: none. Pages are index >> page_shift. Values lie on the device, the rest on the
/// host.
struct KeptRows {
  const std::uint8_t* values = nullptr;
  std::size_t stride = 0;
  std::span<const std::int32_t> row;
  std::span<const std::uint64_t> lights_of_page;
};

/// Share of each light's disc that each Gaussian's surface point sees, 255 for all of it: percentage-closer filtering
/// (Reeves et al. 1987) under a paraboloid, every texel compared with the depth of the surface's own plane there
/// (receiver plane bias, Isidoro 2006), so that slanted surfaces do not shade themselves. What faces away from the
/// light is 0, and what a point or a spot light does not reach (range, cone). A light that casts no shadow is 255
/// everywhere. Of cascades the finest that has the whole filter is tested, outside of the last all is lit; of a point
/// light's maps the one whose axis is nearest.
///
/// Tested is the mean, brought back onto the plane of surface_point. Reads mean, surface_point, normal, the scales, and
/// object_id or, of a model in pages, the ranges' frame_id. `visibility`
/// is [lights][gaussians.count], by index; what is no Gaussian's holds anything. What Gaussians and maps point to, and
/// `visibility`, lie in memory of the stream's device; the ranges on the host. At most 64 lights. Waits for the result.
/// Throws std::runtime_error when the device fails.
void compute_visibility(device::StreamView stream, const GaussiansView& gaussians, const ObjectTransforms& objects,
                        std::span<const MappedLight> lights, const VisibilityOptions& options, std::uint8_t* visibility,
                        const KeptRows& kept = {});

}  // namespace splatbus::relight
