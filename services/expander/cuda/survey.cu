#include "device/check.h"
#include "expander/cuda/device_math.cuh"

namespace splatbus::expander::cuda {
namespace {

using device::check;

__device__ const DeviceObject* find_object(const RoundView& round, std::uint32_t id) {
  const int at =
      device::find_sorted(round.objects, round.object_count, id, [](const DeviceObject& object) { return object.id; });
  return at < 0 ? nullptr : round.objects + at;
}

__device__ bool depth_matches(const RoundView& round, std::uint32_t camera_index, const float3& position,
                              float tolerance) {
  const DeviceCamera& camera = round.cameras[camera_index];
  const float3 p = transform(camera.camera_from_world, position);
  const float scale = camera.orthographic ? 1.0F : 1.0F / p.z;
  const float x = camera.fx * p.x * scale + camera.cx, y = camera.fy * p.y * scale + camera.cy;
  if (!(p.z > 0) || !(x >= 0) || !(y >= 0) || x >= static_cast<float>(round.width) ||
      y >= static_cast<float>(round.height)) {
    return false;
  }
  const std::size_t row = std::size_t{camera_index} * round.height + static_cast<std::size_t>(y);
  const float depth = round.depth_m[row * round.width + static_cast<std::size_t>(x)];
  return fabsf(depth - p.z) <= tolerance * p.z;
}

__global__ void survey_kernel(RoundView round, SurveyOptions options, Placement placement, std::uint32_t* unseen) {
  const std::uint32_t i = thread_index();
  bool overlooked = false;
  if (i < round.count) {
    const std::uint32_t camera = round.samples.camera[i];
    float3 position = round.samples.position[i], normal = round.samples.normal[i];
    CellId key = kNoCell;
    if (camera != kUnsound) {
      const std::uint32_t object_id = round.samples.object_id[i];
      const DeviceObject* object = find_object(round, object_id);
      const bool seen = !(round.samples.cosine[i] < options.min_cosine) &&
                        (object != nullptr || depth_matches(round, camera, position, options.depth_tolerance));
      overlooked = !seen;
      const float3 offset = options.viewer - position;
      if (seen && !(sqrtf(dot(offset, offset)) > options.candidate_radius_m)) {
        if (object != nullptr) {
          position = transform(object->object_from_world, position);
          normal = rotate(object->object_from_world, normal);
        }
        key = cell_at(position, cell_prefix(object != nullptr, object_id), options.cell_size_m);
      }
    }
    placement.key[i] = key;
    placement.position[i] = position;
    placement.normal[i] = normal;
  }
  const int in_block = __syncthreads_count(overlooked);
  if (threadIdx.x == 0 && in_block > 0) atomicAdd(unseen, static_cast<std::uint32_t>(in_block));
}

}  // namespace

void launch_survey(const RoundView& round, const SurveyOptions& options, const Placement& placement,
                   std::uint32_t* unseen, cudaStream_t stream) {
  check(cudaMemsetAsync(unseen, 0, sizeof(std::uint32_t), stream), "clearing a count");
  if (round.count == 0) return;
  survey_kernel<<<blocks_for(round.count), kThreads, 0, stream>>>(round, options, placement, unseen);
  check(cudaGetLastError(), "surveying samples");
}

}  // namespace splatbus::expander::cuda
