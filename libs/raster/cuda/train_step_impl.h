#pragma once

#include <deque>
#include <memory>
#include <vector>

#include "device/buffer.h"
#include "device/stream.h"
#include "raster/cuda/adam_state.h"
#include "raster/cuda/train_step.h"
#include "raster/cuda/view_group.h"

namespace splatbus::raster::cuda {

struct TrainStep::Impl {
  explicit Impl(TrainStepOptions o) : options(o) {}
  ~Impl();
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  TrainStepOptions options;
  device::Stream own_stream;
  cudaStream_t stream = own_stream.get();
  DeviceGaussians gaussians;
  AdamState adam;
  device::Buffer<float> learning_rate;
  Staging staging;
  std::vector<std::unique_ptr<ViewGroup>> groups;
  Workspace workspace;
  WorkspaceView last_view;
  const ViewGroup* last = nullptr;
  StepsInFlight in_flight;
  std::deque<Report> reports;

  [[nodiscard]] bool keeps_lists() const;
  [[nodiscard]] ProjectOptions project_options(bool rebuild) const;
  [[nodiscard]] WorkspaceRequest request_for(int width, int height, int batch, const Targets& targets,
                                             std::uint32_t pairs) const;
  WorkspaceView workspace_for(ViewGroup& group);
  void losses(const ViewGroup& group, const WorkspaceView& w);
  void update(const WorkspaceView& w);
  void enqueue_forward(const WorkspaceView& w, bool rebuild);
  void enqueue_training(const ViewGroup& group, const WorkspaceView& w);
  void run(std::size_t index, bool train);
  /// Takes note of the steps that are done; of all of them, after waiting, with `wait`.
  void retire(bool wait);

 private:
  void picture_loss(const float* rendered, const ViewGroup& group, bool of_albedo, float* gradient,
                    const WorkspaceView& w);
  bool retire_one(bool wait);
  void size_lists(ViewGroup& group);
};

}  // namespace splatbus::raster::cuda
