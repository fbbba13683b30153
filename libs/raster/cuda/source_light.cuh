#pragma once

#include "raster/cuda/projection_math.cuh"
#include "raster/cuda/workspace.h"

namespace splatbus::raster::cuda {

__device__ inline float facing(const float3 normal, const float3 to_light) {
  return fmaxf(0.0F, normal.x * to_light.x + normal.y * to_light.y + normal.z * to_light.z);
}

/// Calls add(irradiance over pi, unit direction to the light in the object's frame) for each source whose light reaches
/// a Gaussian in view b.
template <class Add>
__device__ inline void for_each_source(const WorkspaceView& w, int b, const ObjectView& object, const float3 mean,
                                       int i, Add add) {
  const float* v = object.view_from_object;
  const float3 point = make_float3(v[0] * mean.x + v[1] * mean.y + v[2] * mean.z + v[3],
                                   v[4] * mean.x + v[5] * mean.y + v[6] * mean.z + v[7],
                                   v[8] * mean.x + v[9] * mean.y + v[10] * mean.z + v[11]);
  const float min_distance = kMinSourceDistance_m * object.scale, inverse_scale = 1.0F / object.scale;
  const ShadingSource* const sources = w.sources + b * w.source_room;
#pragma unroll 1
  for (int j = 0; j < object.source_count; ++j) {
    const ShadingSource& source = sources[j];
    float3 to_light = make_float3(source.direction[0], source.direction[1], source.direction[2]);
    float weight = 1.0F;
    if (!source.directional) {
      const float3 axis = to_light;
      const float3 way =
          make_float3(source.position[0] - point.x, source.position[1] - point.y, source.position[2] - point.z);
      const float distance = fmaxf(sqrtf(way.x * way.x + way.y * way.y + way.z * way.z), min_distance);
      const float share = distance * source.inverse_range, share2 = share * share;
      const float window = 1.0F - share2 * share2;
      if (!(window > 0.0F)) continue;
      const float inverse_distance = 1.0F / distance;
      to_light = make_float3(way.x * inverse_distance, way.y * inverse_distance, way.z * inverse_distance);
      const float from_edge = -(to_light.x * axis.x + to_light.y * axis.y + to_light.z * axis.z) - source.cos_outer;
      const float root = window * inverse_distance * __saturatef(from_edge * source.inverse_cone);
      weight = root * root;
    }
    if (source.visibility != nullptr) weight *= (1.0F / 255) * static_cast<float>(source.visibility[i]);
    if (!(weight > 0.0F)) continue;
    add(make_float3(weight * source.intensity_over_pi[0], weight * source.intensity_over_pi[1],
                    weight * source.intensity_over_pi[2]),
        make_float3(inverse_scale * (v[0] * to_light.x + v[4] * to_light.y + v[8] * to_light.z),
                    inverse_scale * (v[1] * to_light.x + v[5] * to_light.y + v[9] * to_light.z),
                    inverse_scale * (v[2] * to_light.x + v[6] * to_light.y + v[10] * to_light.z)));
  }
}

}  // namespace splatbus::raster::cuda
