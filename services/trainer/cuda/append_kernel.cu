#include "device/check.h"
#include "device/sorted.cuh"
#include "device/srgb.cuh"
#include "trainer/cuda/column_kernels.h"

namespace splatbus::trainer::cuda {

namespace {

constexpr int kThreads = 256;
constexpr float kPi = 3.14159265358979323846F;
constexpr float kShC0 = 0.28209479177387814F;  // signs and constants as in gaussians/sh.h
constexpr float kShC1 = 0.4886025119029199F;

/// Irradiance over pi of one colour on a surface with unit normal n: ambient_reflected() of gaussians/light.h.
__device__ float ambient_reflected(const float (&sh)[27], int color, float3 n) {
  const float x = n.x, y = n.y, z = n.z;
  const float basis[9] = {kShC0,
                          -2.0F / 3 * kShC1 * y,
                          2.0F / 3 * kShC1 * z,
                          -2.0F / 3 * kShC1 * x,
                          0.25F * 1.0925484305920792F * x * y,
                          0.25F * -1.0925484305920792F * y * z,
                          0.25F * 0.31539156525252005F * (2 * z * z - x * x - y * y),
                          0.25F * -1.0925484305920792F * x * z,
                          0.25F * 0.5462742152960396F * (x * x - y * y)};
  float sum = 0;
#pragma unroll
  for (int k = 0; k < 9; ++k) sum += basis[k] * sh[3 * k + color];
  return sum;
}

__device__ float3 turned(float3 v, const ObjectRotation& q) {
  // v + 2 w (u x v) + 2 u x (u x v), u the quaternion's vector part.
  const float3 uv = make_float3(q.y * v.z - q.z * v.y, q.z * v.x - q.x * v.z, q.x * v.y - q.y * v.x);
  const float3 uuv = make_float3(q.y * uv.z - q.z * uv.y, q.z * uv.x - q.x * uv.z, q.x * uv.y - q.y * uv.x);
  return make_float3(v.x + 2 * (q.w * uv.x + uuv.x), v.y + 2 * (q.w * uv.y + uuv.y), v.z + 2 * (q.w * uv.z + uuv.z));
}

__device__ float3 world_normal(const InsertRows& rows, std::uint32_t row, const ObjectRotation* objects,
                               std::uint32_t object_count) {
  const float3 normal =
      make_float3(rows.normal[row], rows.normal[rows.stride + row], rows.normal[2 * rows.stride + row]);
  const int found = device::find_sorted(objects, object_count, rows.object_id[row],
                                        [](const ObjectRotation& object) { return object.id; });
  return found < 0 ? normal : turned(normal, objects[found]);
}

__global__ void append(ModelPlanes p, InsertRows rows, std::uint32_t first, std::uint32_t count, std::uint64_t first_id,
                       InsertLight light, const ObjectRotation* objects, std::uint32_t object_count) {
  const std::uint32_t row = blockIdx.x * kThreads + threadIdx.x;
  if (row >= count) return;
  const std::int64_t i = std::int64_t{first} + row;
  const auto set = [&](int channel, float value) {
    p.parameters[channel * p.capacity + i] = value;
    p.average[channel * p.capacity + i] = value;
  };
  const auto fill = [&](int channel, const float* planes, int channels) {
    for (int c = 0; c < channels; ++c) set(channel + c, planes[c * rows.stride + row]);
  };
  fill(ParameterLayout::kMean, rows.mean, 3);
  fill(ParameterLayout::kLogScale, rows.log_scale, 3);
  fill(ParameterLayout::kRotation, rows.rotation, 4);
  fill(ParameterLayout::kOpacityLogit, rows.opacity_logit, 1);
  const float visibility = rows.visibility[row];
  if (p.layout.appearance == Appearance::Transfer) {
    fill(ParameterLayout::kAlbedo, rows.albedo, 3);
  } else {
    const float3 n = world_normal(rows, row, objects, object_count);
    const float cosine =
        fmaxf(0.0F, n.x * light.sun_direction[0] + n.y * light.sun_direction[1] + n.z * light.sun_direction[2]);
    for (int c = 0; c < 3; ++c) {
      const float direct = light.sun_irradiance[c] * (visibility * cosine / kPi);
      const float lit =
          rows.albedo[c * rows.stride + row] * (fmaxf(ambient_reflected(light.ambient_sh, c, n), 0.0F) + direct);
      set(ParameterLayout::kAppearance + c, (device::srgb_from_linear(lit) - 0.5F) / kShC0);
    }
  }
  for (int c = ParameterLayout::kAppearance + 3; c < p.layout.channels(); ++c) set(c, 0.0F);
  for (int c = 0; c < 3; ++c) {
    p.normal[c * p.capacity + i] = rows.normal[c * rows.stride + row];
    p.surface_point[c * p.capacity + i] = rows.mean[c * rows.stride + row];
  }
  p.visibility[i] = visibility;
  p.object_id[i] = rows.object_id[row];
  p.cell[i] = rows.cell[row];
  p.flags[i] = 0;
  p.gaussian_id[i] = first_id + row;
}

}  // namespace

void launch_append(const ModelPlanes& planes, const InsertRows& rows, std::uint32_t first, std::uint32_t count,
                   std::uint64_t first_id, const InsertLight& light, const ObjectRotation* objects,
                   std::uint32_t object_count, cudaStream_t stream) {
  if (count == 0) return;
  append<<<(count + kThreads - 1) / kThreads, kThreads, 0, stream>>>(planes, rows, first, count, first_id, light,
                                                                     objects, object_count);
  device::check(cudaGetLastError(), "appending columns");
}

}  // namespace splatbus::trainer::cuda
