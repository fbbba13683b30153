#include "device/check.h"
#include "expander/cuda/device_math.cuh"

namespace splatbus::expander::cuda {
namespace {

using device::check;

constexpr float kPi = 3.14159265358979323846F;

__device__ float luminance(const float3& linear) {
  return dot(linear, float3{0.2126F, 0.7152F, 0.0722F});
}

__device__ float guess_visibility(const float3& color, const float3& albedo, const float3& n,
                                  const InitialValues& values) {
  const float facing = fmaxf(0.0F, dot(n, values.sun_direction));
  const float sun = luminance(albedo * values.sun_irradiance) * facing / kPi;
  if (sun < values.least_sun_part) return 1;
  const float3* const a = values.ambient;
  const float3 reflected = a[0] + a[1] * n.y + a[2] * n.z + a[3] * n.x + a[4] * (n.x * n.y) + a[5] * (n.y * n.z) +
                           a[6] * (2 * n.z * n.z - n.x * n.x - n.y * n.y) + a[7] * (n.x * n.z) +
                           a[8] * (n.x * n.x - n.y * n.y);
  const float3 positive{fmaxf(reflected.x, 0.0F), fmaxf(reflected.y, 0.0F), fmaxf(reflected.z, 0.0F)};
  return fminf(fmaxf((luminance(color) - luminance(albedo * positive)) / sun, 0.0F), 1.0F);
}

/// w x y z, as rotation_to_normal.
__device__ float4 rotation_to(const float3& normal) {
  if (normal.z < -0.9999F) return {0, 1, 0, 0};
  const float w = 1 + normal.z, x = -normal.y, y = normal.x;
  const float scale = 1.0F / sqrtf((w * w + x * x) + y * y);
  return {w * scale, x * scale, y * scale, 0};
}

__device__ void put(float* planes, std::size_t count, std::size_t i, const float3& v) {
  planes[i] = v.x;
  planes[count + i] = v.y;
  planes[2 * count + i] = v.z;
}

__global__ void gaussians_kernel(RoundView round, Placement placement, const std::uint32_t* chosen,
                                 InitialValues values, BatchSpan batches) {
  const std::uint32_t k = thread_index();
  if (k >= batches.count) return;
  const std::uint32_t batch = k / batches.batch_size, first = batch * batches.batch_size;
  const std::size_t n = min(batches.batch_size, batches.count - first), i = k - first;
  const InsertPlanes planes = insert_planes(batches.data + batch * batches.batch_stride, n);
  const std::uint32_t s = chosen[k];
  const float3 normal = placement.normal[s], albedo = round.samples.albedo[s];
  const float along = logf(fmaxf(round.samples.spacing_m[s], values.least_spacing_m) * values.scale);
  const float4 rotation = rotation_to(normal);
  put(planes.mean, n, i, placement.position[s]);
  put(planes.log_scale, n, i, {along, along, along + values.log_flatness});
  planes.rotation[i] = rotation.x;
  planes.rotation[n + i] = rotation.y;
  planes.rotation[2 * n + i] = rotation.z;
  planes.rotation[3 * n + i] = rotation.w;
  planes.opacity_logit[i] = values.opacity_logit;
  put(planes.albedo, n, i, albedo);
  put(planes.normal, n, i, normal);
  planes.visibility[i] = guess_visibility(round.samples.color[s], albedo, round.samples.normal[s], values);
  planes.object_id[i] = round.samples.object_id[s];
  planes.cell[i] = placement.key[s];
}

}  // namespace

void launch_gaussians(const RoundView& round, const Placement& placement, const std::uint32_t* chosen,
                      const InitialValues& values, const BatchSpan& batches, cudaStream_t stream) {
  if (batches.count == 0) return;
  gaussians_kernel<<<blocks_for(batches.count), kThreads, 0, stream>>>(round, placement, chosen, values, batches);
  check(cudaGetLastError(), "making Gaussians");
}

}  // namespace splatbus::expander::cuda
