#include <thrust/iterator/counting_iterator.h>

#include <cub/device/device_select.cuh>

#include "capture-bridge/cuda/kernels.h"
#include "capture-bridge/cuda/launch.h"

namespace splatbus::capture_bridge::cuda {
namespace {

struct Survives {
  const SurfaceRank* ranks;
  int cameras_per_surface;
  __device__ bool operator()(std::uint32_t pixel) const {
    const int rank = ranks[pixel].rank;
    return rank != 0 && rank <= cameras_per_surface;
  }
};

__global__ void gather_kernel(RoundPixels round, int cameras_per_surface, Survivors survivors) {
  const std::uint32_t s = item_of_thread();
  if (s >= survivors.count) return;
  const std::uint32_t pixel = survivors.pixel[s];
  const Texel texel = round.texels[pixel];
  const Vec3 position = position_in_round(round.views[pixel / round.view_pixels], texel);
  survivors.position[3 * s] = position.x;
  survivors.position[3 * s + 1] = position.y;
  survivors.position[3 * s + 2] = position.z;
  survivors.area_m2[s] = area_of(texel, round.ranks[pixel], cameras_per_surface);
}

}  // namespace

void launch_survivors(const RoundPixels& round, int cameras_per_surface, const Survivors& survivors,
                      Buffer<std::byte>& scratch, std::uint32_t* selected, cudaStream_t stream) {
  if (survivors.count == 0) return;
  const Survives survives{round.ranks, cameras_per_surface};
  run_cub(scratch, "selecting samples", [&](void* bytes, std::size_t& size) {
    return cub::DeviceSelect::If(bytes, size, thrust::counting_iterator<std::uint32_t>(0), survivors.pixel, selected,
                                 static_cast<int>(round.pixels()), survives, stream);
  });
  gather_kernel<<<blocks_for(survivors.count), kThreads, 0, stream>>>(round, cameras_per_surface, survivors);
  check_launch("gathering samples");
}

}  // namespace splatbus::capture_bridge::cuda
