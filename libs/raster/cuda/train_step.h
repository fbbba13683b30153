#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "raster/cuda/kernels.h"
#include "raster/cuda/view_tables.h"

namespace splatbus::raster::cuda {

struct TrainStepOptions {
  ProjectOptions project;
  float ssim_weight = 0.2F;
  float albedo_weight = 0.0F;  ///< of the albedo picture's loss; 0: none is rendered. Transfer only
  float beta1 = 0.9F, beta2 = 0.999F, epsilon = 1e-15F;
  int active_channels = 0;
  int rebuild_interval = 1;      ///< steps of a group that share one set of sorted tile lists
  bool use_depth_limit = false;  ///< leave hidden Gaussians out of the lists
  bool use_graph = true;
  bool training = true;  ///< false: forward() only, and no memory for more; pictures may be null
};

/// A training view: camera, scene and pictures, u8 RGBA on the device, which must stay there as long as the group does.
struct TrainView {
  SceneView view;
  const std::uint8_t* color = nullptr;
  const std::uint8_t* albedo = nullptr;  ///< needed when albedo_weight > 0
};

/// Render, loss, backward, Adam on device memory, without a host synchronisation inside a step. Views are trained in
/// groups of one size of picture; a group keeps its sorted tile lists from step to step (cameras stand still, Gaussians
/// move little) and renews them every rebuild_interval steps.
///
/// One thread at a time. Throws std::runtime_error naming the CUDA error.
class TrainStep {
 public:
  explicit TrainStep(TrainStepOptions options);
  ~TrainStep();
  TrainStep(const TrainStep&) = delete;
  TrainStep& operator=(const TrainStep&) = delete;

  /// The model to train in place, device memory; `object_id` on the host, null: all static. Groups are dropped; Adam's
  /// moments begin anew unless `keep_moments` and the layout and the stride are as before.
  void set_model(const DeviceGaussians& gaussians, const std::uint32_t* host_object_id, bool keep_moments = false);
  /// One rate a channel.
  void set_learning_rates(const std::vector<float>& rates);

  /// All views of one size, at most kMaxBatch. Returns the group's index.
  std::size_t add_group(std::span<const TrainView> views);
  void clear_groups();

  /// Enqueues one step on stream(). Now and then it looks at counters of steps long done, to grow buffers.
  void step(std::size_t group);
  /// Forward only: fills color() and, when rendered, albedo.
  void forward(std::size_t group);

  /// Loss of each view of the last step; synchronises.
  [[nodiscard]] std::vector<float> losses();
  /// [batch][3][h][w] of the last step or forward().
  [[nodiscard]] const float* color() const;
  [[nodiscard]] cudaStream_t stream() const;
  [[nodiscard]] std::size_t bytes() const;  ///< device memory that it owns

  /// The stages of whole steps that are trained to this end, each between two events (median of `repeats`), for
  /// benchmarks. A step that reuses its lists has "project" instead of "project_and_list" and "sort".
  struct StageTime {
    const char* name;
    float milliseconds;
  };
  [[nodiscard]] std::vector<StageTime> time_stages(std::size_t group, int repeats);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace splatbus::raster::cuda
