#pragma once

#include <cuda_runtime_api.h>

#include <cstddef>
#include <cstdint>

// What compute_visibility needs, as plain numbers and device pointers.
namespace splatbus::relight::cuda {

/// a_from_b: p_a = rotation * p_b + translation; rotation row-major.
struct Transform {
  float rotation[9];
  float translation[3];
};

struct ObjectTransform {
  std::uint32_t id;
  Transform world_from_object;
};

struct SurfacePlanes {
  std::size_t count = 0, stride = 0;
  const float* surface_point = nullptr;      ///< [3][stride]
  const float* normal = nullptr;             ///< [3][stride]
  const float* log_scale = nullptr;          ///< [3][stride]; null: points
  const std::uint32_t* object_id = nullptr;  ///< [stride]; null: all static
};

/// An orthographic depth map; fx and fy in texels a metre.
struct LightMap {
  int width = 0, height = 0;
  float fx = 0, fy = 0, cx = 0, cy = 0;
  Transform light_from_world{};
  const float* depth_m = nullptr;  ///< [height][width]
};

struct FilterOptions {
  float softness_m, footprint, lift_texels;
};

/// Enqueues the test of every Gaussian. `objects` are sorted by id, without duplicates. Throws std::runtime_error.
void launch_visibility(const SurfacePlanes& surface, const LightMap& map, const ObjectTransform* objects,
                       int object_count, const FilterOptions& options, float* visibility, cudaStream_t stream);

}  // namespace splatbus::relight::cuda
