#include <thrust/execution_policy.h>
#include <thrust/sort.h>

#include <cmath>

#include "device/check.h"
#include "gaussians/layout.h"
#include "stream/cuda/observe_kernels.h"

namespace splatbus::stream::cuda {
namespace {

constexpr unsigned kThreads = 256;
constexpr unsigned kAllLanes = 0xFFFFFFFFU;

unsigned blocks_for(std::size_t count) {
  return static_cast<unsigned>((count + kThreads - 1) / kThreads);
}

__device__ std::size_t column_of_thread() {
  return std::size_t{blockIdx.x} * kThreads + threadIdx.x;
}

/// Adds the number of threads of the block whose `flag` is set. All threads of the block call it.
__device__ void count_block(bool flag, std::uint32_t* counter) {
  const int set = __syncthreads_count(flag ? 1 : 0);
  if (threadIdx.x == 0 && set > 0) atomicAdd(counter, static_cast<std::uint32_t>(set));
}

template <class T>
__device__ bool replace(T& kept, T value) {
  const bool changed = kept != value;
  if (changed) kept = value;
  return changed;
}

__global__ void ids_kernel(ModelPlanes model, Integers integers, ObservedCounts* counts) {
  const std::size_t i = column_of_thread();
  bool changed = false;
  if (i < model.count) {
    const std::uint64_t id = model.gaussian_id != nullptr ? model.gaussian_id[i] : i + 1;
    changed = replace(integers.gaussian_id[i], id);
  }
  count_block(changed, &counts->ids);
}

__device__ bool all_finite(const float* planes, std::size_t stride, int channels, std::size_t i) {
  bool finite = true;
  for (int c = 0; c < channels; ++c) finite = finite && isfinite(planes[static_cast<std::size_t>(c) * stride + i]);
  return finite;
}

__global__ void usable_kernel(ModelPlanes model, Integers integers, ObservedCounts* counts) {
  const std::size_t i = column_of_thread();
  bool usable_changed = false, object_changed = false;
  if (i < model.count) {
    bool usable = all_finite(model.parameters, model.stride, model.channels, i);
    if (model.normal != nullptr) usable = usable && all_finite(model.normal, model.stride, 3, i);
    if (model.visibility != nullptr) usable = usable && isfinite(model.visibility[i]);
    usable_changed = replace(integers.usable[i], static_cast<std::uint8_t>(usable ? 1 : 0));
    object_changed = replace(integers.object_id[i], model.object_id != nullptr ? model.object_id[i] : 0U);
  }
  count_block(usable_changed, &counts->usable);
  count_block(object_changed, &counts->object_ids);
}

/// Room in the list of changes for every lane that wants it: one addition a warp.
__device__ std::uint32_t place_in_list(bool wanted, std::uint32_t* counter) {
  const unsigned wanting = __ballot_sync(kAllLanes, wanted);
  if (wanting == 0) return 0;
  const unsigned lane = threadIdx.x % 32U;
  const int leader = __ffs(static_cast<int>(wanting)) - 1;
  std::uint32_t base = 0;
  if (static_cast<int>(lane) == leader) base = atomicAdd(counter, static_cast<std::uint32_t>(__popc(wanting)));
  base = __shfl_sync(kAllLanes, base, leader);
  return base + static_cast<std::uint32_t>(__popc(wanting & ((1U << lane) - 1U)));
}

struct ChangeList {
  ValueChange* changes;
  std::uint32_t capacity;
  ObservedCounts* counts;
};

/// All lanes of a warp call it, `inside` or not.
__device__ void keep(const PlanePlan& plan, int neighbour, const ModelPlanes& model, const Integers& integers,
                     const ChangeList& list, std::size_t i, bool inside, std::int32_t value) {
  bool changed = false;
  if (inside) {
    const std::size_t at = static_cast<std::size_t>(plan.storage + neighbour) * model.count + i;
    changed = plan.is_wide ? replace(integers.wide[at], value)
                           : replace(integers.narrow[at], static_cast<std::int16_t>(value));
  }
  const std::uint32_t place = place_in_list(changed, &list.counts->values);
  if (changed && place < list.capacity) {
    const auto channel = static_cast<std::uint32_t>(plan.first + neighbour);
    list.changes[place] = {channel << kChannelShift | static_cast<std::uint32_t>(i), value};
  }
}

__device__ coding::Vector rotation_vector(const PlanePlan& plan, const ModelPlanes& model, const HeldRotation* held,
                                          std::size_t i) {
  const auto value = [&](int c) {
    return model.parameters[static_cast<std::size_t>(plan.source + c) * model.stride + i];
  };
  coding::Quaternion reference;
  if (held != nullptr && held[i].held != 0) {
    reference = coding::from_rotation_vector({static_cast<float>(held[i].x) * plan.unit,
                                              static_cast<float>(held[i].y) * plan.unit,
                                              static_cast<float>(held[i].z) * plan.unit});
  }
  const coding::Quaternion q = coding::normalized({value(0), value(1), value(2), value(3)});
  return coding::to_rotation_vector(coding::nearest_equivalent(q, reference));
}

/// A row of blocks for each plan: all threads of a block take the same branch.
__global__ void quantise_kernel(ModelPlanes model, Plans plans, const HeldRotation* held, Integers integers,
                                ChangeList list) {
  const PlanePlan& plan = plans.plan[blockIdx.y];
  const std::size_t i = column_of_thread();
  const bool inside = i < model.count;
  const bool usable = inside && integers.usable[i] != 0;
  const auto put = [&](int neighbour, std::int32_t value) {
    keep(plan, neighbour, model, integers, list, i, inside, value);
  };
  if (plan.coding == Coding::Rotation) {
    coding::Vector v{};
    if (usable) v = rotation_vector(plan, model, held, i);
    put(0, usable ? plan.step(v.x) : 0);
    put(1, usable ? plan.step(v.y) : 0);
    put(2, usable ? plan.step(v.z) : 0);
    return;
  }
  if (plan.coding == Coding::Normal) {
    coding::Octahedral e{};
    if (usable) {
      e = model.normal != nullptr
              ? coding::octahedral(model.normal[i], model.normal[model.stride + i], model.normal[2 * model.stride + i])
              : coding::octahedral(0.0F, 1.0F, 0.0F);
    }
    put(0, usable ? plan.step(e.x) : 0);
    put(1, usable ? plan.step(e.y) : 0);
    return;
  }
  std::int32_t q = 0;
  if (usable) {
    float value = 1.0F;
    if (plan.coding != Coding::Visibility) {
      value = model.parameters[static_cast<std::size_t>(plan.source) * model.stride + i];
    } else if (model.visibility != nullptr) {
      value = model.visibility[i];
    }
    if (plan.coding == Coding::Opacity) value = coding::sigmoid(value);
    if (plan.coding == Coding::Albedo) value = coding::srgb_odd(value);
    q = plan.step(value);
  }
  put(0, q);
}

__global__ void extents_kernel(ModelPlanes model, float* extents, ObservedCounts* counts) {
  const std::size_t i = column_of_thread();
  bool finite = false;
  if (i < model.count) {
    const float* scales = model.parameters + static_cast<std::size_t>(ParameterLayout::kLogScale) * model.stride;
    const float extent = coding::middle_of(scales[i], scales[model.stride + i], scales[2 * model.stride + i]);
    finite = isfinite(extent);
    extents[i] = finite ? extent : INFINITY;
  }
  count_block(finite, &counts->finite_extents);
}

}  // namespace

void launch_ids(const ModelPlanes& model, const Integers& integers, ObservedCounts* counts, cudaStream_t stream) {
  device::check(cudaMemsetAsync(counts, 0, sizeof(ObservedCounts), stream), "clearing counts");
  if (model.count == 0) return;
  ids_kernel<<<blocks_for(model.count), kThreads, 0, stream>>>(model, integers, counts);
  device::check(cudaGetLastError(), "comparing ids");
}

void launch_quantize(const ModelPlanes& model, const Plans& plans, const HeldRotation* held, const Integers& integers,
                     ValueChange* changes, std::uint32_t capacity, ObservedCounts* counts, cudaStream_t stream) {
  device::check(cudaMemsetAsync(counts, 0, sizeof(ObservedCounts), stream), "clearing counts");
  if (model.count == 0) return;
  usable_kernel<<<blocks_for(model.count), kThreads, 0, stream>>>(model, integers, counts);
  device::check(cudaGetLastError(), "marking usable columns");
  const dim3 grid(blocks_for(model.count), static_cast<unsigned>(plans.count));
  quantise_kernel<<<grid, kThreads, 0, stream>>>(model, plans, held, integers, {changes, capacity, counts});
  device::check(cudaGetLastError(), "quantizing");
}

void launch_extents(const ModelPlanes& model, float* extents, ObservedCounts* counts, cudaStream_t stream) {
  device::check(cudaMemsetAsync(counts, 0, sizeof(ObservedCounts), stream), "clearing counts");
  if (model.count == 0) return;
  extents_kernel<<<blocks_for(model.count), kThreads, 0, stream>>>(model, extents, counts);
  device::check(cudaGetLastError(), "measuring extents");
  thrust::sort(thrust::cuda::par.on(stream), extents, extents + model.count);
}

}  // namespace splatbus::stream::cuda
