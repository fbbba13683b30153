#include <c10/cuda/CUDAGuard.h>
#include <c10/cuda/CUDAStream.h>

#include <algorithm>
#include <cstring>
#include <span>
#include <stdexcept>

#include "raster/cuda/kernels.h"
#include "raster/cuda/view_tables.h"
#include "raster/torch/backend.h"
#include "raster/torch/cuda/isect_guesses.h"
#include "raster/torch/cuda/tensor_arena.h"

namespace splatbus::raster {
namespace {

using cuda::check;
using torch::Tensor;

template <class T>
T* data_or_null(const Tensor& plane) {
  return plane.defined() ? static_cast<T*>(plane.data_ptr()) : nullptr;
}

std::uint32_t even(std::uint32_t isects) {
  return (std::max<std::uint32_t>(isects, 32) + 1) / 2 * 2;
}

/// A word of the device that the host reads while the device goes on.
class WordToHost {
 public:
  WordToHost() { check(cudaEventCreateWithFlags(&copied_, cudaEventDisableTiming), "making an event"); }
  ~WordToHost() { cudaEventDestroy(copied_); }
  WordToHost(const WordToHost&) = delete;
  WordToHost& operator=(const WordToHost&) = delete;

  void copy(const std::uint32_t* device, cudaStream_t stream) {
    check(cudaMemcpyAsync(word_.data_ptr(), device, sizeof(std::uint32_t), cudaMemcpyDeviceToHost, stream),
          "reading the number of intersections");
    check(cudaEventRecord(copied_, stream), "recording an event");
  }
  [[nodiscard]] std::uint32_t wait() const {
    check(cudaEventSynchronize(copied_), "waiting for the number of intersections");
    return *static_cast<const std::uint32_t*>(word_.data_ptr());
  }

 private:
  Tensor word_ = torch::empty({1}, torch::TensorOptions().dtype(at::kInt).pinned_memory(true));
  cudaEvent_t copied_ = nullptr;
};

class CudaPass final : public RasterPass {
 public:
  using RasterPass::RasterPass;

  RasterizedViews forward(const Tensor& parameters, bool differentiable, std::vector<Tensor>& kept) override {
    const c10::cuda::CUDAGuard guard(parameters.device());
    const cudaStream_t stream = c10::cuda::getCurrentCUDAStream().stream();
    const auto type = parameters.options().requires_grad(false);
    const cuda::DeviceGaussians gaussians = gaussians_of(parameters);
    w_.count = w_.rows = gaussians.count;
    w_.batch = static_cast<int>(call.cameras.size());
    w_.width = static_cast<int>(call.cameras[0].width);
    w_.height = static_cast<int>(call.cameras[0].height);
    w_.tiles_x = (w_.width + cuda::kTileSize - 1) / cuda::kTileSize;
    w_.tiles_y = (w_.height + cuda::kTileSize - 1) / cuda::kTileSize;
    project_ = {.blur_px2 = call.options.blur_px2, .antialias = call.options.antialias};

    RasterizedViews views = allocate_pictures(type);
    const Tensor transmittance = views.alpha;
    kept = {views.color, views.albedo, views.depth, transmittance};
    copy_tables(gaussians, type, kept, stream);

    static cuda::IsectGuesses guesses;
    const cuda::IsectGuesses::Kind kind{parameters.device().index(), w_.batch, w_.width, w_.height};
    WordToHost isects_to_host;
    Tensor lists;
    for (w_.isect_capacity = guesses.guess(kind, gaussians.count);;) {
      const Tensor scratch = allocate_lists(type, differentiable, lists);
      cuda::launch_clear_counts(w_, stream);
      cuda::launch_project(gaussians, w_, project_, stream);
      isects_to_host.copy(&w_.counts->isects, stream);
      // Lists that do not fit are drawn for nothing; to wait before it is known would cost every call.
      cuda::launch_sort(w_, stream);
      cuda::launch_blend_forward(gaussians, w_, stream);
      const std::uint32_t isects = isects_to_host.wait();
      guesses.note(kind, std::min(isects, cuda::kMaxIsects));
      if (isects <= w_.isect_capacity) break;
      if (isects > cuda::kMaxIsects) {
        throw std::runtime_error("rasterize: Gaussians meet more tiles than can be sorted");
      }
      w_.isect_capacity = cuda::IsectGuesses::with_room(isects);
    }
    kept.push_back(lists);
    views.alpha = 1 - transmittance;
    return views;
  }

  Tensor backward(const Tensor& parameters, const std::vector<Tensor>& /*kept*/,
                  const RasterizedViews& views) override {
    const c10::cuda::CUDAGuard guard(parameters.device());
    const cudaStream_t stream = c10::cuda::getCurrentCUDAStream().stream();
    const auto type = parameters.options().requires_grad(false);
    const cuda::DeviceGaussians gaussians = gaussians_of(parameters);
    Tensor gradient = torch::zeros(parameters.sizes(), type);
    if (gaussians.count == 0) return gradient;

    cuda::WorkspaceView w = w_;
    const auto count = static_cast<std::size_t>(w.count), projected = count * static_cast<std::size_t>(w.batch);
    const GaussianStatistics& statistics = call.statistics;
    std::uint8_t* touched = nullptr;
    cuda::ScreenStatistics screen{.mean2d_norm = data_or_null<float>(statistics.mean2d_norm)};
    cuda::TensorArena arena;
    arena.add(w.projected_gradient, projected * cuda::kGradientFloats);
    arena.add(w.projected_depth_gradient, views.depth.defined() ? projected : 0);
    arena.add(w.projected_visible, projected);
    arena.add(touched, statistics.touched.defined() ? 0 : count);
    arena.add(screen.steps, screen.mean2d_norm != nullptr ? count : 0);
    const Tensor sums = arena.allocate(type).zero_();
    if (touched == nullptr) touched = statistics.touched.data_ptr<std::uint8_t>();
    const Gradients gradients = bind_gradients(views, type, w);
    cuda::launch_blend_backward(gaussians, w, stream);
    cuda::launch_gradient(gaussians, w, project_, gradient.data_ptr<float>(), touched, screen, 0, stream);
    if (statistics.contribution.defined()) {
      for (int view = 0; view < w.batch; ++view) {
        cuda::launch_contribution(gaussians, w, view, statistics.contribution.data_ptr<float>(), stream);
      }
    }
    return gradient;
  }

 private:
  [[nodiscard]] cuda::DeviceGaussians gaussians_of(const Tensor& parameters) const {
    const GaussianPlanes& planes = call.planes;
    return {.layout = call.layout,
            .count = static_cast<int>(parameters.size(1)),
            .stride = parameters.size(1),
            .parameters = static_cast<float*>(parameters.data_ptr()),
            .normal = data_or_null<float>(planes.normal),
            .visibility = data_or_null<float>(planes.visibility),
            .object_id = data_or_null<std::uint32_t>(planes.object_id),
            .flags = data_or_null<std::uint32_t>(planes.flags)};
  }

  using Gradients = std::vector<Tensor>;

  /// Points `w` at what leads to the pictures; the tensors hold the memory.
  [[nodiscard]] Gradients bind_gradients(const RasterizedViews& views, const torch::TensorOptions& type,
                                         cuda::WorkspaceView& w) const {
    Gradients held;
    const auto bind = [&](const Tensor& gradient, at::IntArrayRef shape) {
      held.push_back(gradient.defined() ? gradient : torch::zeros(shape, type));
      return held.back().data_ptr<float>();
    };
    const std::int64_t batch = w.batch, height = w.height, width = w.width;
    w.color_gradient = bind(views.color, {batch, 3, height, width});
    if (w.albedo != nullptr) w.albedo_gradient = bind(views.albedo, {batch, 3, height, width});
    if (views.depth.defined()) w.depth_gradient = bind(views.depth, {batch, height, width});
    // The kernels take a gradient through depth only together with one through alpha.
    if (views.alpha.defined() || views.depth.defined()) w.alpha_gradient = bind(views.alpha, {batch, height, width});
    return held;
  }

  RasterizedViews allocate_pictures(const torch::TensorOptions& type) {
    const std::int64_t batch = w_.batch, height = w_.height, width = w_.width;
    RasterizedViews views{torch::empty({batch, 3, height, width}, type), torch::empty({batch, height, width}, type),
                          has_albedo(call) ? torch::empty({batch, 3, height, width}, type) : Tensor(),
                          call.options.depth ? torch::empty({batch, height, width}, type) : Tensor()};
    w_.color = views.color.data_ptr<float>();
    w_.transmittance = views.alpha.data_ptr<float>();
    w_.albedo = data_or_null<float>(views.albedo);
    w_.depth = data_or_null<float>(views.depth);
    return views;
  }

  /// Cameras, objects and light, and the row of each Gaussian's object.
  void copy_tables(const cuda::DeviceGaussians& gaussians, const torch::TensorOptions& type, std::vector<Tensor>& kept,
                   cudaStream_t stream) {
    std::vector<cuda::SceneView> scenes;
    for (std::size_t k = 0; k < call.cameras.size(); ++k) scenes.push_back({call.cameras[k], &call.scene(k)});
    const cuda::ViewTables tables = cuda::make_view_tables(scenes, call.layout.appearance);
    const bool slotted = gaussians.object_id != nullptr;
    w_.object_count = tables.object_count;
    w_.source_room = tables.source_room;

    // The host's copy has the layout of the device's, so that one copy takes all.
    std::uint32_t* object_ids = nullptr;
    const auto add_tables = [&](cuda::TensorArena& arena) {
      arena.add(w_.views, tables.views.size());
      arena.add(w_.object_views, tables.object_views.size());
      arena.add(w_.sources, tables.sources.size());
      arena.add(object_ids, slotted ? tables.object_ids.size() : 0);
    };
    cuda::TensorArena on_host, on_device;
    add_tables(on_host);
    const Tensor host = on_host.allocate(torch::TensorOptions().pinned_memory(true));
    std::memcpy(w_.views, tables.views.data(), std::span(tables.views).size_bytes());
    std::memcpy(w_.object_views, tables.object_views.data(), std::span(tables.object_views).size_bytes());
    if (w_.sources != nullptr) std::memcpy(w_.sources, tables.sources.data(), std::span(tables.sources).size_bytes());
    if (object_ids != nullptr)
      std::memcpy(object_ids, tables.object_ids.data(), std::span(tables.object_ids).size_bytes());
    add_tables(on_device);
    kept.push_back(on_device.allocate(type).copy_(host, /*non_blocking=*/true));

    w_.object_slot = nullptr;
    if (!slotted) return;
    cuda::TensorArena slots;
    slots.add(w_.object_slot, static_cast<std::size_t>(gaussians.count));
    kept.push_back(slots.allocate(type));
    cuda::launch_object_slots(gaussians, object_ids, static_cast<int>(tables.object_ids.size()), w_.object_slot,
                              stream);
  }

  /// Projected Gaussians and lists, as Workspace lays them out, for w_.isect_capacity intersections: `lists` is what
  /// backward() reads. Returns the rest, to be held until the forward pass is enqueued.
  Tensor allocate_lists(const torch::TensorOptions& type, bool differentiable, Tensor& lists) {
    const auto batch = static_cast<std::size_t>(w_.batch), count = static_cast<std::size_t>(w_.count);
    const std::size_t tiles = static_cast<std::size_t>(w_.tiles_x) * static_cast<std::size_t>(w_.tiles_y) * batch;
    const std::size_t projected = std::max<std::size_t>(count * batch, 1), isects = even(w_.isect_capacity);
    cuda::TensorArena kept, scratch;
    kept.add(w_.projected_shape, 2 * projected);
    kept.add(w_.projected_tail, projected);
    kept.add(w_.flatten_ids[1], isects + 3);  // read four at a time
    kept.add(w_.counts, 1);
    kept.add(w_.tile_offsets, tiles);
    // The backward pass finds the colours of segments where the keys were.
    (differentiable ? kept : scratch).add(w_.isect_ids[0], 2 * isects);
    scratch.add(w_.flatten_ids[0], isects);
    w_.sort_scratch_bytes = cuda::sort_scratch_bytes(static_cast<std::uint32_t>(isects));
    std::byte* sort_scratch = nullptr;
    scratch.add(sort_scratch, w_.sort_scratch_bytes);
    w_.segments = nullptr;
    if (differentiable) {
      constexpr std::size_t kLanes = 32;
      const std::size_t segments = std::max<std::size_t>(isects * cuda::kPatches / (kLanes * cuda::kSegmentGroups), 1);
      w_.segment_capacity = static_cast<std::uint32_t>(segments);
      kept.add(w_.segments, segments);
      kept.add(w_.segment_extra, w_.albedo != nullptr || w_.depth != nullptr ? kLanes * segments : 0);
    }
    lists = Tensor();
    lists = kept.allocate(type);
    Tensor rest = scratch.allocate(type);
    w_.isect_ids[1] = w_.isect_ids[0] + isects;
    w_.sort_scratch = sort_scratch;
    w_.segment_color = reinterpret_cast<float4*>(w_.isect_ids[0]);
    return rest;
  }

  cuda::WorkspaceView w_;  // points into what was kept
  cuda::ProjectOptions project_;
};

}  // namespace

c10::intrusive_ptr<RasterPass> make_cuda_pass(RasterCall call) {
  return c10::make_intrusive<CudaPass>(std::move(call));
}

}  // namespace splatbus::raster
