#pragma once

#include <cstddef>
#include <cstdint>

#ifdef __CUDACC__
#define EXPANDER_HOST_DEVICE __host__ __device__
#else
#define EXPANDER_HOST_DEVICE
#endif

namespace splatbus::expander {

/// Where the planes of a batch lie, [channels][count] each: one after the other in one allocation, the widest elements
/// first. Also read by kernels, so free of other headers.
struct InsertPlanes {
  std::uint64_t* cell;
  float *mean, *log_scale, *rotation, *opacity_logit, *albedo, *normal, *visibility;
  std::uint32_t* object_id;
};

inline constexpr std::size_t kInsertBytes = sizeof(std::uint64_t) + 18 * sizeof(float) + sizeof(std::uint32_t);

/// `data` is aligned to 8 bytes and has count * kInsertBytes of room; host or device.
EXPANDER_HOST_DEVICE inline InsertPlanes insert_planes(std::byte* data, std::size_t count) {
  auto* const cell = reinterpret_cast<std::uint64_t*>(data);
  auto* const mean = reinterpret_cast<float*>(cell + count);
  float* const log_scale = mean + 3 * count;
  float* const rotation = log_scale + 3 * count;
  float* const opacity_logit = rotation + 4 * count;
  float* const albedo = opacity_logit + count;
  float* const normal = albedo + 3 * count;
  float* const visibility = normal + 3 * count;
  return {.cell = cell,
          .mean = mean,
          .log_scale = log_scale,
          .rotation = rotation,
          .opacity_logit = opacity_logit,
          .albedo = albedo,
          .normal = normal,
          .visibility = visibility,
          .object_id = reinterpret_cast<std::uint32_t*>(visibility + count)};
}

}  // namespace splatbus::expander

#undef EXPANDER_HOST_DEVICE
