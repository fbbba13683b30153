#include "raster/cuda/kernels.h"

namespace splatbus::raster::cuda {
namespace {

constexpr int kThreads = 256;

__global__ void object_slots_kernel(const std::uint32_t* object_id, int count, const std::uint32_t* ids, int id_count,
                                    std::uint16_t* slots) {
  const int i = blockIdx.x * kThreads + threadIdx.x;
  if (i >= count) return;
  const std::uint32_t id = object_id[i];
  int low = 0, high = id_count;
  while (low < high) {
    const int middle = (low + high) / 2;
    if (ids[middle] < id) {
      low = middle + 1;
    } else {
      high = middle;
    }
  }
  slots[i] = low < id_count && ids[low] == id ? static_cast<std::uint16_t>(1 + low) : 0;
}

}  // namespace

void launch_object_slots(const std::uint32_t* object_id, int count, const std::uint32_t* object_ids, int id_count,
                         std::uint16_t* slots, cudaStream_t stream) {
  if (count == 0) return;
  object_slots_kernel<<<(count + kThreads - 1) / kThreads, kThreads, 0, stream>>>(object_id, count, object_ids,
                                                                                  id_count, slots);
  check(cudaGetLastError(), "object slots");
}

}  // namespace splatbus::raster::cuda
