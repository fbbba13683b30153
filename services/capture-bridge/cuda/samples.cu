#include <cub/device/device_radix_sort.cuh>

#include "capture-bridge/cuda/kernels.h"
#include "capture-bridge/cuda/launch.h"

namespace splatbus::capture_bridge::cuda {
namespace {

__device__ void store3(float* array, std::uint32_t i, const Vec3& v) {
  array[3 * i] = v.x;
  array[3 * i + 1] = v.y;
  array[3 * i + 2] = v.z;
}

__global__ void sample_kernel(RoundPixels round, Survivors survivors, const std::uint32_t* kept, float spacing_growth,
                              const LinearTable* linear, SampleArrays samples) {
  const std::uint32_t k = item_of_thread();
  if (k >= samples.count) return;
  const std::uint32_t survivor = kept[k];
  const std::uint32_t pixel = survivors.pixel[survivor];
  const std::uint32_t camera = pixel / round.view_pixels;
  const std::size_t in_view = pixel - camera * round.view_pixels;
  const PixelView& view = round.views[camera];
  const Texel texel = round.texels[pixel];
  store3(samples.position, k, load3(survivors.position, survivor));
  store3(samples.normal, k, normal_in_round(view, texel));
  store3(samples.color, k, without_background(*linear, view.color + 4 * in_view, view.background));
  store3(samples.albedo, k, without_background(*linear, view.albedo + 4 * in_view, Vec3()));
  samples.footprint_m[k] = fabsf(texel.footprint_m);
  samples.spacing_m[k] = sqrtf(survivors.area_m2[survivor]) * spacing_growth;
  samples.cosine[k] = round.cosine[pixel];
  samples.object_id[k] = texel.object_id;
  samples.camera[k] = camera;
}

__global__ void height_kernel(SampleArrays samples, float* heights) {
  const std::uint32_t k = item_of_thread();
  if (k < samples.count) heights[k] = samples.position[3 * k + 1];
}

}  // namespace

void launch_samples(const RoundPixels& round, const Survivors& survivors, const std::uint32_t* kept,
                    float spacing_growth, const LinearTable* linear, const SampleArrays& samples, cudaStream_t stream) {
  if (samples.count == 0) return;
  sample_kernel<<<blocks_for(samples.count), kThreads, 0, stream>>>(round, survivors, kept, spacing_growth, linear,
                                                                    samples);
  check_launch("writing samples");
}

void launch_heights(const SampleArrays& samples, float* unsorted, float* heights, Buffer<std::byte>& scratch,
                    cudaStream_t stream) {
  if (samples.count == 0) return;
  height_kernel<<<blocks_for(samples.count), kThreads, 0, stream>>>(samples, unsorted);
  check_launch("reading heights");
  run_cub(scratch, "sorting heights", [&](void* bytes, std::size_t& size) {
    return cub::DeviceRadixSort::SortKeys(bytes, size, unsorted, heights, static_cast<int>(samples.count), 0, 32,
                                          stream);
  });
}

}  // namespace splatbus::capture_bridge::cuda
