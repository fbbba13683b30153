#include "device/check.h"
#include "expander/cuda/device_math.cuh"

namespace splatbus::expander::cuda {
namespace {

using device::check;

__device__ float3 get(const float* planes, std::size_t stride, std::size_t i) {
  return {planes[i], planes[stride + i], planes[2 * stride + i]};
}

__global__ void batch_points_kernel(InsertPlanes planes, std::uint32_t count, ModelledPoint* points,
                                    std::uint64_t* keys) {
  const std::uint32_t i = thread_index();
  if (i >= count) return;
  points[i] = {get(planes.mean, count, i), get(planes.normal, count, i)};
  keys[i] = planes.cell[i];
}

__global__ void model_points_kernel(ModelPlanes planes, std::uint32_t count, float cell_size_m, ModelledPoint* points,
                                    std::uint64_t* keys) {
  const std::uint32_t i = thread_index();
  if (i >= count) return;
  const ModelledPoint point{get(planes.position, planes.stride, i), get(planes.normal, planes.stride, i)};
  const bool local = (planes.cell[i] & kObjectCell) != 0;
  points[i] = point;
  keys[i] = cell_at(point.position, cell_prefix(local, planes.object_id[i]), cell_size_m);
}

__global__ void gather_kernel(const ModelledPoint* from, const std::uint32_t* order, std::uint32_t count,
                              ModelledPoint* points) {
  const std::uint32_t i = thread_index();
  if (i < count) points[i] = from[order[i]];
}

__global__ void find_exact_kernel(InsertPlanes planes, std::uint32_t count, ModelledView modelled,
                                  std::uint32_t* found) {
  const std::uint32_t i = thread_index();
  if (i >= count) return;
  const int cell = find_cell(modelled.cells, *modelled.cells.cells, planes.cell[i]);
  if (cell < 0) return;
  const float3 position = get(planes.mean, count, i);
  for (std::uint32_t k = modelled.cells.start[cell]; k < modelled.cells.start[cell + 1]; ++k) {
    const float3 there = modelled.points[k].position;
    if (there.x == position.x && there.y == position.y && there.z == position.z) atomicOr(found, 1U);
  }
}

}  // namespace

void launch_points_of_batch(const InsertPlanes& planes, std::uint32_t count, ModelledPoint* points, std::uint64_t* keys,
                            cudaStream_t stream) {
  if (count == 0) return;
  batch_points_kernel<<<blocks_for(count), kThreads, 0, stream>>>(planes, count, points, keys);
  check(cudaGetLastError(), "reading a batch");
}

void launch_points_of_model(const ModelPlanes& planes, std::uint32_t count, float cell_size_m, ModelledPoint* points,
                            std::uint64_t* keys, cudaStream_t stream) {
  if (count == 0) return;
  model_points_kernel<<<blocks_for(count), kThreads, 0, stream>>>(planes, count, cell_size_m, points, keys);
  check(cudaGetLastError(), "reading a model");
}

void launch_gather(const ModelledPoint* from, const std::uint32_t* order, std::uint32_t count, ModelledPoint* points,
                   cudaStream_t stream) {
  if (count == 0) return;
  gather_kernel<<<blocks_for(count), kThreads, 0, stream>>>(from, order, count, points);
  check(cudaGetLastError(), "gathering points");
}

void launch_find_exact(const InsertPlanes& planes, std::uint32_t count, const ModelledView& modelled,
                       std::uint32_t* found, cudaStream_t stream) {
  check(cudaMemsetAsync(found, 0, sizeof(std::uint32_t), stream), "clearing a flag");
  if (count == 0) return;
  find_exact_kernel<<<blocks_for(count), kThreads, 0, stream>>>(planes, count, modelled, found);
  check(cudaGetLastError(), "finding points");
}

}  // namespace splatbus::expander::cuda
