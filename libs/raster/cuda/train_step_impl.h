#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "device/buffer.h"
#include "raster/cuda/train_step.h"

namespace splatbus::raster::cuda {

/// A step captured once and launched often.
class Graph {
 public:
  Graph() = default;
  ~Graph() { reset(); }
  Graph(const Graph&) = delete;
  Graph& operator=(const Graph&) = delete;

  void reset() {
    if (executable_ != nullptr) cudaGraphExecDestroy(executable_);
    executable_ = nullptr;
  }
  void launch(cudaStream_t stream, const std::function<void()>& enqueue) {
    if (executable_ == nullptr) {
      cudaGraph_t graph = nullptr;
      check(cudaStreamBeginCapture(stream, cudaStreamCaptureModeThreadLocal), "capturing a step");
      enqueue();
      check(cudaStreamEndCapture(stream, &graph), "capturing a step");
      const cudaError_t status = cudaGraphInstantiate(&executable_, graph, 0);
      cudaGraphDestroy(graph);
      check(status, "making a step's graph");
    }
    check(cudaGraphLaunch(executable_, stream), "launching a step");
  }

 private:
  cudaGraphExec_t executable_ = nullptr;
};

/// Views that are trained together, and their tile lists.
struct Group {
  std::vector<TrainView> views;
  int width = 0, height = 0;
  device::Buffer<DeviceView> device_views;
  device::Buffer<ObjectView> object_views;
  device::Buffer<std::uint16_t> object_slot;  // of this group's objects; empty when nothing moves
  device::Buffer<const std::uint8_t*> color_targets, albedo_targets;
  device::Buffer<uint2> tile_range;
  device::Buffer<float> patch_depth_limit;
  device::Buffer<std::uint32_t> entries;
  device::Buffer<std::uint16_t> listed;
  int steps = 0;  // since the lists were built
  bool lists_built = false;
  Graph rebuild_graph, reuse_graph;
};

struct TrainStep::Impl {
  explicit Impl(TrainStepOptions o);
  ~Impl();
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  TrainStepOptions options;
  cudaStream_t stream = nullptr;
  DeviceGaussians gaussians;
  std::vector<std::uint32_t> host_object_id;
  device::Buffer<float> first, second, learning_rate;
  device::Buffer<std::uint32_t> steps;
  std::vector<std::unique_ptr<Group>> groups;
  Workspace workspace;
  std::uint32_t pair_capacity = 1U << 20U;
  std::uint32_t* host_pair_count = nullptr;
  const Group* last = nullptr;

  [[nodiscard]] bool albedo() const;
  [[nodiscard]] bool keeps_lists() const;
  WorkspaceView workspace_for(const Group& group);
  [[nodiscard]] ProjectOptions project_options(bool rebuild) const;
  void read_pair_count(const WorkspaceView& w);
  void losses(const Group& group, const WorkspaceView& w);
  void update(const WorkspaceView& w);
  void enqueue_forward(const WorkspaceView& w, bool rebuild);
  void enqueue_training(const Group& group, const WorkspaceView& w);
  void run(Group& group, bool train);

 private:
  void picture_loss(const float* rendered, const Group& group, bool of_albedo, float* gradient, const WorkspaceView& w);
  void grow_if_needed(Group& group);
  void size_lists(Group& group);
  void drop_graphs();
};

}  // namespace splatbus::raster::cuda
