#pragma once

#include <cstdint>

#include "device/sorted.cuh"
#include "expander/cuda/kernels.h"

// Vector arithmetic in the order in which GLM does it on the host.
namespace splatbus::expander::cuda {

constexpr int kThreads = 256;

inline unsigned blocks_for(std::uint32_t n) {
  return (n + kThreads - 1) / kThreads;
}

__device__ inline std::uint32_t thread_index() {
  return blockIdx.x * blockDim.x + threadIdx.x;
}

__device__ inline float3 operator+(const float3& a, const float3& b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
__device__ inline float3 operator-(const float3& a, const float3& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
__device__ inline float3 operator*(const float3& a, const float3& b) {
  return {a.x * b.x, a.y * b.y, a.z * b.z};
}
__device__ inline float3 operator*(const float3& a, float s) {
  return {a.x * s, a.y * s, a.z * s};
}
__device__ inline float dot(const float3& a, const float3& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
__device__ inline float3 cross(const float3& a, const float3& b) {
  return {a.y * b.z - b.y * a.z, a.z * b.x - b.z * a.x, a.x * b.y - b.x * a.y};
}
__device__ inline bool finite(const float3& v) {
  return isfinite(v.x) && isfinite(v.y) && isfinite(v.z);
}

__device__ inline float3 rotate(const DeviceRigid& by, const float3& v) {
  const float3 axis{by.x, by.y, by.z};
  const float3 once = cross(axis, v);
  const float3 twice = cross(axis, once);
  return v + (once * by.w + twice) * 2.0F;
}
__device__ inline float3 transform(const DeviceRigid& by, const float3& point) {
  return rotate(by, point) + by.translation;
}

/// The cell that holds a point of the frame that `prefix` names; kNoCell when ids cannot name it.
__device__ inline CellId cell_at(const float3& point, CellId prefix, float cell_size_m) {
  const auto along = [&](float v) { return floorf(v / cell_size_m + 0.5F); };
  return pack_floored(along(point.x), along(point.y), along(point.z), prefix);
}

/// Index of a cell in a table, or -1.
__device__ inline int find_cell(const CellTableView& table, std::uint32_t cells, CellId cell) {
  return device::find_sorted(table.id, cells, cell);
}

}  // namespace splatbus::expander::cuda
