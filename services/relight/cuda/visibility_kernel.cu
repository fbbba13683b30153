#include "device/check.h"
#include "device/sorted.cuh"
#include "relight/cuda/visibility_kernel.h"
#include "relight/visibility_limits.h"

namespace splatbus::relight::cuda {
namespace {

constexpr unsigned kThreads = 256;
constexpr int kLanes = 8;  // of a Gaussian
constexpr unsigned kGaussiansABlock = kThreads / kLanes;

struct Vector {
  float x, y, z;
};

__device__ Vector load(const float* planes, std::size_t stride, std::size_t i) {
  return {planes[i], planes[stride + i], planes[2 * stride + i]};
}

__device__ Vector rotate(const Transform& t, const Vector& v) {
  return {t.rotation[0] * v.x + t.rotation[1] * v.y + t.rotation[2] * v.z,
          t.rotation[3] * v.x + t.rotation[4] * v.y + t.rotation[5] * v.z,
          t.rotation[6] * v.x + t.rotation[7] * v.y + t.rotation[8] * v.z};
}

__device__ Vector apply(const Transform& t, const Vector& p) {
  const Vector r = rotate(t, p);
  return {r.x + t.translation[0], r.y + t.translation[1], r.z + t.translation[2]};
}

/// Null when the object does not move.
__device__ const Transform* find(const ObjectTransform* objects, int count, std::uint32_t id) {
  const int at = device::find_sorted(objects, static_cast<std::uint32_t>(count), id,
                                     [](const ObjectTransform& object) { return object.id; });
  return at < 0 ? nullptr : &objects[at].world_from_object;
}

/// Mean of the two larger standard deviations.
__device__ float surface_deviation_m(const SurfacePlanes& surface, std::size_t i) {
  if (surface.log_scale == nullptr) return 0.0F;
  const Vector s = load(surface.log_scale, surface.stride, i);
  if (isnan(s.x + s.y + s.z)) return kGreatestDeviation_m;
  const float largest = fmaxf(s.x, fmaxf(s.y, s.z));
  const float middle = fmaxf(fminf(s.x, s.y), fminf(fmaxf(s.x, s.y), s.z));
  const float mean = 0.5F * (expf(middle) + expf(largest));
  return fminf(mean, kGreatestDeviation_m);
}

/// The plane of a surface in texels across and metres of depth, and the filter's radius in texels.
struct Receiver {
  float x, y, depth_m;
  float slope_x, slope_y;  // metres of depth a texel
  float radius_x, radius_y;
};

__device__ float bounded_radius(float texels) {
  return fminf(fmaxf(texels, kLeastRadius_texels), kGreatestRadius_texels);
}

/// False where no light can arrive.
__device__ bool make_receiver(const SurfacePlanes& surface, const LightMap& map, const ObjectTransform* objects,
                              int object_count, const FilterOptions& options, std::size_t i, Receiver& receiver) {
  Vector point = load(surface.surface_point, surface.stride, i);
  Vector normal_world = load(surface.normal, surface.stride, i);
  if (object_count > 0 && surface.object_id != nullptr) {
    if (const Transform* world_from_object = find(objects, object_count, surface.object_id[i])) {
      point = apply(*world_from_object, point);
      normal_world = rotate(*world_from_object, normal_world);
    }
  }
  const Vector normal = rotate(map.light_from_world, normal_world);
  const float facing = -normal.z;
  if (!(facing > kLeastFacing)) return false;
  const float lift_m = options.lift_texels / fminf(map.fx, map.fy);
  point = {point.x + normal_world.x * lift_m, point.y + normal_world.y * lift_m, point.z + normal_world.z * lift_m};
  point = apply(map.light_from_world, point);
  float slope_x = normal.x / facing, slope_y = normal.y / facing;
  const float steepness = sqrtf(slope_x * slope_x + slope_y * slope_y);
  if (steepness > kGreatestSlope) {
    slope_x *= kGreatestSlope / steepness;
    slope_y *= kGreatestSlope / steepness;
  }
  const float radius_m =
      kParaboloidOverDisc * (options.softness_m + options.footprint * surface_deviation_m(surface, i));
  receiver = {.x = map.fx * point.x + map.cx,
              .y = map.fy * point.y + map.cy,
              .depth_m = point.z,
              .slope_x = slope_x / map.fx,
              .slope_y = slope_y / map.fy,
              .radius_x = bounded_radius(radius_m * map.fx),
              .radius_y = bounded_radius(radius_m * map.fy)};
  return isfinite(receiver.depth_m + receiver.x + receiver.y);
}

/// kLanes threads a Gaussian, each for every kLanes-th texel of a row: neighbours read neighbouring texels.
__global__ void __launch_bounds__(kThreads)
    visibility_kernel(SurfacePlanes surface, LightMap map, const ObjectTransform* __restrict__ objects,
                      int object_count, FilterOptions options, float* __restrict__ visibility) {
  const std::size_t i = std::size_t{blockIdx.x} * kGaussiansABlock + threadIdx.x / kLanes;
  const int lane = static_cast<int>(threadIdx.x) % kLanes;
  if (i >= surface.count) return;
  Receiver r{};
  if (!make_receiver(surface, map, objects, object_count, options, i, r)) {
    if (lane == 0) visibility[i] = 0.0F;
    return;
  }
  const float low_x = floorf(r.x - r.radius_x), low_y = floorf(r.y - r.radius_y);
  const float high_x = ceilf(r.x + r.radius_x), high_y = ceilf(r.y + r.radius_y);
  if (high_x < 0.0F || high_y < 0.0F || low_x > static_cast<float>(map.width) ||
      low_y > static_cast<float>(map.height)) {
    if (lane == 0) visibility[i] = 1.0F;
    return;
  }
  const int right = static_cast<int>(high_x), bottom = static_cast<int>(high_y);
  float lit = 0.0F, weight = 0.0F;
  for (int y = static_cast<int>(low_y); y < bottom; ++y) {
    const float dy = (static_cast<float>(y) + 0.5F - r.y) / r.radius_y;
    const float row_m = r.depth_m + r.slope_y * (static_cast<float>(y) + 0.5F - r.y);
    const float* row = map.depth_m + static_cast<std::ptrdiff_t>(y) * map.width;
    for (int x = static_cast<int>(low_x) + lane; x < right; x += kLanes) {
      const float offset = static_cast<float>(x) + 0.5F - r.x;
      const float dx = offset / r.radius_x;
      const float share = fmaxf(0.0F, 1.0F - dx * dx - dy * dy);
      // What lies outside of the map is lit; a depth that is not a number hides.
      const bool inside = x >= 0 && x < map.width && y >= 0 && y < map.height;
      const bool reached = !inside || row_m + r.slope_x * offset <= row[x];
      weight += share;
      lit += reached ? share : 0.0F;
    }
  }
  const unsigned group = 0xFFU << (threadIdx.x % 32U / kLanes * kLanes);
  for (int step = kLanes / 2; step > 0; step /= 2) {
    lit += __shfl_xor_sync(group, lit, step);
    weight += __shfl_xor_sync(group, weight, step);
  }
  if (lane == 0) visibility[i] = lit < weight ? lit / weight : 1.0F;
}

}  // namespace

void launch_visibility(const SurfacePlanes& surface, const LightMap& map, const ObjectTransform* objects,
                       int object_count, const FilterOptions& options, float* visibility, cudaStream_t stream) {
  if (surface.count == 0) return;
  const auto blocks = static_cast<unsigned>((surface.count + kGaussiansABlock - 1) / kGaussiansABlock);
  visibility_kernel<<<blocks, kThreads, 0, stream>>>(surface, map, objects, object_count, options, visibility);
  device::check(cudaGetLastError(), "launching the visibility test");
}

}  // namespace splatbus::relight::cuda
