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
  float depth_weight = 0.0F;   ///< a metre, of mean |depth - alpha * reference| over the picture; 0: none is rendered
  bool statistics = false;     ///< statistics() are gathered
  float beta1 = 0.9F, beta2 = 0.999F, epsilon = 1e-15F;
  int active_channels = 0;
  bool unit_albedo = false;                   ///< Transfer: albedo stays within [0, 1]
  float half_rate_steps = 0, least_rate = 0;  ///< as in Adam
  int rebuild_interval = 1;                   ///< steps of a group that share one set of sorted tile lists
  bool use_depth_limit = false;               ///< leave hidden Gaussians out of the lists
  bool use_graph = true;
  bool training = true;  ///< false: forward() only, and no memory for more; pictures may be null
};

/// A training view: camera, scene and pictures on the device (u8 RGBA; depth float), which must stay there until the
/// steps that were given them are done. `view.scene` is read during the call only.
struct TrainView {
  SceneView view;
  const std::uint8_t* color = nullptr;
  const std::uint8_t* albedo = nullptr;  ///< null: this view has no albedo loss
  const float* depth = nullptr;          ///< metres along z, 0 where there is no surface; null: it has no depth loss
};

/// Render, loss, backward, Adam on device memory, without a host synchronisation inside a step. Views are trained in
/// groups of one size of picture. A group keeps its sorted tile lists from step to step (cameras stand still, Gaussians
/// move little) and renews them every rebuild_interval steps; or its views are renewed before every step.
///
/// A few steps may be on their way at once; step() waits for the oldest when they are too many. A step whose lists turn
/// out not to fit their memory changes nothing; the memory grows as soon as that is known.
///
/// The arrays of a step grow with its pictures (64 bytes a pixel, 24 more with albedo, 12 with depth), with its lists
/// (24 bytes a pair of a Gaussian and a tile, 16 more with albedo or depth) and with views times Gaussians (89 bytes).
/// add_group(), step() and forward() throw StepTooLarge when a step would take more than kMostPixels or more memory
/// than the device has free, kMemoryLeftFree aside. Nothing is allocated then and nothing lost: the model, Adam's
/// moments and all groups stay as they are, steps under way come to their end, and what fits trains on, the same group
/// with other views too.
///
/// One thread at a time. Throws std::runtime_error naming the CUDA error.
class TrainStep {
 public:
  explicit TrainStep(TrainStepOptions options);
  ~TrainStep();
  TrainStep(const TrainStep&) = delete;
  TrainStep& operator=(const TrainStep&) = delete;

  /// `training` and `rebuild_interval` stay as they were made.
  void set_options(const TrainStepOptions& options);
  /// The model to train in place, device memory, object_id too (null: all static). Groups are dropped and Adam's
  /// moments begin anew.
  void set_model(const DeviceGaussians& gaussians);
  /// The same model after a change of its structure, of the same layout, planes perhaps elsewhere and with another
  /// stride. Groups stay. Columns below both counts keep their moments and statistics, others begin without.
  void follow_model(const DeviceGaussians& gaussians);
  /// Moves Adam's moments and the statistics as columns were moved, from[k] to to[k], before follow_model(): device
  /// arrays, read by stream().
  void move_columns(const std::uint32_t* from, const std::uint32_t* to, int count);
  /// One rate a channel.
  void set_learning_rates(const std::vector<float>& rates);

  /// All views of one size, at most kMaxBatch. Returns the group's index.
  std::size_t add_group(std::span<const TrainView> views);
  /// Puts other views, of the same number and size, in the place of a group's: no allocation and no wait, unless more
  /// objects move.
  void renew_group(std::size_t group, std::span<const TrainView> views);
  void clear_groups();

  /// Enqueues one step on stream().
  void step(std::size_t group);
  /// Forward only: fills color() and, when rendered, albedo.
  void forward(std::size_t group);

  /// A step that is done.
  struct Report {
    float loss = 0;        ///< mean over its views
    bool changed = false;  ///< false: its lists did not fit
  };
  /// Steps that are done and were not reported yet, in order; after waiting for all of them when `wait` is set.
  [[nodiscard]] std::vector<Report> finished(bool wait);

  /// Loss of each view of the last step; synchronises.
  [[nodiscard]] std::vector<float> losses();
  /// [batch][3][h][w] of the last step or forward(); null where workspace() is empty.
  [[nodiscard]] const float* color() const;
  /// Of the steps since set_model() or clear_statistics(), for work on stream(); null where they are not gathered, or
  /// where the model is empty.
  [[nodiscard]] ScreenStatistics statistics() const;
  void clear_statistics();
  /// The arrays of the last step or forward(), for more work on stream() before the next one. All null when that one
  /// was refused or failed, and after clear_groups().
  [[nodiscard]] const WorkspaceView& workspace() const;
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
