#include <algorithm>
#include <cub/block/block_reduce.cuh>
#include <cub/block/block_scan.cuh>

#include "raster/cuda/gaussian_channels.cuh"
#include "raster/cuda/kernels.h"
#include "raster/cuda/object_slot.cuh"

namespace splatbus::raster::cuda {
namespace {

constexpr int kTestThreads = 128, kListThreads = 1024, kBoundsThreads = 256;
static_assert(kMaxBatch <= 16, "a mark has 16 bits for views");

__device__ FrustumCamera frustum_camera(const DeviceView& view, const WorkspaceView& w, float blur_px2) {
  return {.fx = view.fx,
          .fy = view.fy,
          .cx = view.cx,
          .cy = view.cy,
          .width = static_cast<float>(w.width),
          .height = static_cast<float>(w.height),
          .near_m = view.near_m,
          .blur_px2 = blur_px2,
          .max_tan_x = fmaxf(fabsf(view.limit_x_low), fabsf(view.limit_x_high)),
          .max_tan_y = fmaxf(fabsf(view.limit_y_low), fabsf(view.limit_y_high))};
}

/// Without its scale.
__device__ math::Rigid rigid_of(const ObjectView& object) {
  const float* v = object.view_from_object;
  const float s = 1.0F / object.scale;
  const math::Mat3 rotation{
      {s * v[0], s * v[4], s * v[8]}, {s * v[1], s * v[5], s * v[9]}, {s * v[2], s * v[6], s * v[10]}};
  return {rotation, {v[3], v[7], v[11]}};
}

/// Whether a range of the model may show in a view, by its bounds.
__device__ bool shows(const DeviceView& view, const FrustumCamera& camera, const ObjectView& object,
                      const IndexRange& range, const PageBounds& bounds) {
  const math::Rigid view_from_object = rigid_of(object);
  if (!may_show(page_frustum(camera, view_from_object, object.scale), bounds)) return false;
  return range.frame_id == kFarFieldFrame ||
         !is_behind(view.hidden_behind, camera, view_from_object, object.scale, bounds);
}

/// The views that range k may show in.
__device__ std::uint32_t views_of(const DeviceGaussians& g, const WorkspaceView& w, int k, std::uint16_t slot,
                                  float blur_px2) {
  // Where each Gaussian has an object of its own, the range's says only where its bounds are.
  if (g.bounds == nullptr && w.object_slot != nullptr) return (1U << w.batch) - 1;
  if (slot == kHiddenSlot) return 0;
  std::uint32_t views = 0;
  for (int b = 0; b < w.batch; ++b) {
    const ObjectView& object = w.object_views[b * w.object_count + slot];
    if (is_hidden(object)) continue;
    const DeviceView& view = w.views[b];
    if (g.bounds == nullptr || shows(view, frustum_camera(view, w, blur_px2), object, g.ranges[k], g.bounds[k])) {
      views |= 1U << b;
    }
  }
  return views;
}

__global__ void __launch_bounds__(kTestThreads)
    test_ranges_kernel(DeviceGaussians gaussians, WorkspaceView w, float blur_px2) {
  const int k = blockIdx.x * kTestThreads + threadIdx.x;
  if (k >= gaussians.range_count) return;
  const IndexRange range = gaussians.ranges[k];
  const std::uint16_t slot = object_slot(range.frame_id, w.object_ids, w.object_count - 1);
  const std::uint32_t views = range.count > 0 ? views_of(gaussians, w, k, slot, blur_px2) : 0;
  w.range_marks[k] = static_cast<std::uint32_t>(slot) << 16 | views;
}

/// One block, so that the list keeps the ranges' order: a thread takes neighbours.
__global__ void __launch_bounds__(kListThreads) list_ranges_kernel(DeviceGaussians gaussians, WorkspaceView w) {
  using Scan = cub::BlockScan<std::uint32_t, kListThreads>;
  __shared__ typename Scan::TempStorage scratch;
  const int each = (gaussians.range_count + kListThreads - 1) / kListThreads;
  const int begin = static_cast<int>(threadIdx.x) * each, end = min(gaussians.range_count, begin + each);
  const auto shows = [](std::uint32_t mark) { return (mark & 0xFFFFU) != 0; };
  std::uint32_t of_thread = 0, before = 0, all = 0;
  for (int k = begin; k < end; ++k) of_thread += shows(w.range_marks[k]) ? 1 : 0;
  Scan(scratch).ExclusiveSum(of_thread, before, all);
  for (int k = begin; k < end; ++k) {
    const std::uint32_t mark = w.range_marks[k];
    if (!shows(mark)) continue;
    const std::uint32_t at = before++;
    if (at >= w.list_capacity) break;
    const IndexRange range = gaussians.ranges[k];
    if (static_cast<int>(mark >> 16) == w.far_slot) atomicAdd(&w.counts->far_field, 1U);
    w.listed[at] = {.first = range.first,
                    .count = range.count,
                    .frozen = range.frozen,
                    .range = static_cast<std::uint32_t>(k),
                    .mark = mark};
  }
  if (threadIdx.x != 0) return;
  w.counts->seen = all;
  w.counts->listed = min(all, w.list_capacity);
}

struct Union {
  __device__ PageBounds operator()(const PageBounds& a, const PageBounds& b) const {
    return {{fminf(a.low.x, b.low.x), fminf(a.low.y, b.low.y), fminf(a.low.z, b.low.z)},
            {fmaxf(a.high.x, b.high.x), fmaxf(a.high.y, b.high.y), fmaxf(a.high.z, b.high.z)},
            fmaxf(a.max_scale_m, b.max_scale_m)};
  }
};

__global__ void __launch_bounds__(kBoundsThreads) bounds_kernel(DeviceGaussians gaussians, WorkspaceView w) {
  using Reduce = cub::BlockReduce<PageBounds, kBoundsThreads>;
  __shared__ typename Reduce::TempStorage scratch;
  if (blockIdx.x >= w.counts->listed) return;
  const ListedRange range = w.listed[blockIdx.x];
  if (range.frozen != 0) return;
  PageBounds bounds;
  for (std::uint32_t k = threadIdx.x; k < range.count; k += kBoundsThreads) {
    const ChannelsOfOne<float> p = parameters_of(gaussians).of(static_cast<int>(range.first + k));
    constexpr int kMean = ParameterLayout::kMean, kScale = ParameterLayout::kLogScale;
    include(bounds, {p[kMean], p[kMean + 1], p[kMean + 2]}, fmaxf(p[kScale], fmaxf(p[kScale + 1], p[kScale + 2])));
  }
  bounds = Reduce(scratch).Reduce(bounds, Union());
  if (threadIdx.x == 0) gaussians.bounds[range.range] = bounds;
}

}  // namespace

void launch_list_ranges(const DeviceGaussians& gaussians, const WorkspaceView& workspace, float blur_px2,
                        cudaStream_t stream) {
  if (gaussians.range_count == 0) return;
  const auto blocks = static_cast<unsigned>((gaussians.range_count + kTestThreads - 1) / kTestThreads);
  test_ranges_kernel<<<blocks, kTestThreads, 0, stream>>>(gaussians, workspace, blur_px2);
  list_ranges_kernel<<<1, kListThreads, 0, stream>>>(gaussians, workspace);
  check(cudaGetLastError(), "listing the ranges that views see");
}

void launch_bounds(const DeviceGaussians& gaussians, const WorkspaceView& workspace, cudaStream_t stream) {
  if (gaussians.range_count == 0 || gaussians.bounds == nullptr) return;
  const unsigned ranges = std::min(static_cast<unsigned>(gaussians.range_count), workspace.list_capacity);
  bounds_kernel<<<ranges, kBoundsThreads, 0, stream>>>(gaussians, workspace);
  check(cudaGetLastError(), "bounds");
}

}  // namespace splatbus::raster::cuda
