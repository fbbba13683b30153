#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <span>
#include <tuple>
#include <vector>

#include "device/buffer.h"
#include "device/pinned.h"
#include "device/stream.h"
#include "raster/cuda/adam_state.h"
#include "raster/cuda/kernels.h"
#include "raster/cuda/view_batch.h"
#include "raster/loss_history.h"

namespace splatbus::raster::cuda {

struct TrainStepOptions {
  ProjectOptions project;
  float ssim_weight = 0.2F;
  float albedo_weight = 0.0F;  ///< of the albedo picture's loss; 0: none is rendered. Transfer only
  float depth_weight = 0.0F;   ///< a metre, of mean |depth - alpha * reference| over the picture; 0: none is rendered
  bool statistics = false;     ///< statistics() are gathered
  float beta1 = 0.9F, beta2 = 0.999F, epsilon = 1e-15F;
  int active_channels = 0;
  bool unit_albedo = false;                         ///< Transfer: albedo stays within [0, 1]
  float lr_half_life_steps = 0, lr_min_factor = 0;  ///< as in Adam
  bool lr_recovery = false;  ///< rates rise again where the loss of a view (of one camera id) does
  bool training = true;      ///< false: forward() only, and no memory for more; pictures may be null
};

/// Render, loss, backward, Adam on device memory, without a host synchronisation inside a step. A few steps may be on
/// their way at once; step() waits for the oldest when they are too many. A step that finds more intersections of
/// Gaussians with tiles than there is room for changes nothing; the room grows as soon as that is known, and the step
/// comes again.
///
/// The arrays of a step grow with its pictures (64 bytes a pixel, 24 more with albedo, 12 with depth), with its
/// intersections (24 bytes each, 16 more with albedo or depth) and with views times Gaussians (85 bytes). Pictures of
/// all sizes take turns in them.
///
/// One thread at a time. Throws std::runtime_error naming the CUDA error; what is here is of no use after that.
class TrainStep {
 public:
  explicit TrainStep(const TrainStepOptions& options);
  ~TrainStep();
  TrainStep(const TrainStep&) = delete;
  TrainStep& operator=(const TrainStep&) = delete;

  /// `training` stays as it was made.
  void set_options(const TrainStepOptions& options);
  /// The model to train in place, device memory, object_id too (null: all static). Adam's moments begin anew.
  void set_model(const DeviceGaussians& gaussians);
  /// The same model after a change of its structure, of the same layout, channels perhaps elsewhere and with another
  /// stride. Columns below both counts keep their moments and statistics, others begin without.
  void follow_model(const DeviceGaussians& gaussians);
  /// Gaussians first, first + 1, ... begin without moments and statistics: where others were before them in a page.
  void forget_columns(int first, int count);
  /// Moves Adam's moments and the statistics as columns were moved, from[k] to to[k], before follow_model(): device
  /// arrays, read by stream().
  void move_columns(const std::uint32_t* from, const std::uint32_t* to, int count);
  /// One rate a channel.
  void set_learning_rates(const std::vector<float>& rates);

  /// Enqueues one step on stream(). Views that differ in size, and more of them than fit a launch (kMaxBatch and
  /// kMaxPixels), are trained one part after the other, small pictures first. Throws std::invalid_argument for a
  /// picture of more than kMaxPixels.
  void step(std::span<const TrainView> views);
  /// Only draws them. A picture for whose intersections there was no room is not complete.
  void forward(std::span<const TrainView> views);

  /// Steps that came to their end.
  struct Report {
    std::size_t steps = 0, views = 0;
    double loss = 0;     ///< mean over the views
    double seconds = 0;  ///< in which they were on their way
  };
  /// Those since the last call; all there are, after waiting for them, with `wait`.
  [[nodiscard]] Report finished(bool wait);

  /// Loss of each view of the last launch; synchronises.
  [[nodiscard]] std::vector<float> losses();
  /// The views of the last launch of step() or forward(), whose pictures workspace() holds, and its arrays, for more
  /// work on stream() before the next one. Nothing and null before the first.
  [[nodiscard]] const std::vector<TrainView>& last_views() const { return last_views_; }
  [[nodiscard]] const WorkspaceView& workspace() const { return last_workspace_; }
  /// Of the steps since set_model() or clear_statistics(), for work on stream(); null where they are not gathered, or
  /// where the model is empty.
  [[nodiscard]] ScreenStatistics statistics() const { return adam_.statistics(); }
  void clear_statistics() { adam_.clear_statistics(stream()); }
  [[nodiscard]] cudaStream_t stream() const { return stream_.get(); }
  [[nodiscard]] std::size_t bytes() const;  ///< device memory that it owns

  /// The stages of whole steps that are trained to this end, each between two events (median of `repeats`), for
  /// benchmarks. The views fit one launch.
  struct StageTime {
    const char* name;
    float milliseconds;
  };
  [[nodiscard]] std::vector<StageTime> time_stages(std::span<const TrainView> views, int repeats);

 private:
  using Clock = std::chrono::steady_clock;

  /// Views of one launch: a whole step, or one of several parts of it.
  struct Part {
    std::vector<TrainView> views;
    bool training = true, ends_step = false;
    ViewBatch* batch = nullptr;
    std::uint32_t isect_capacity = 0;  // of its launch
  };

  [[nodiscard]] static std::vector<Part> split(std::span<const TrainView> views);
  ViewBatch& batch_for(std::span<const TrainView> views);
  WorkspaceView workspace_for(ViewBatch& batch);
  [[nodiscard]] int index_capacity();
  void size_isects(ViewBatch& batch);
  void invalidate_graphs();

  void enqueue_forward(const ViewBatch& batch, const WorkspaceView& w);
  void picture_loss(const float* rendered, const ViewBatch& batch, bool of_albedo, float* gradient,
                    const WorkspaceView& w);
  void losses(const ViewBatch& batch, const WorkspaceView& w);
  void update(const ViewBatch& batch, const WorkspaceView& w);
  /// Of a launch's views.
  [[nodiscard]] std::vector<float> loss_limits(std::span<const TrainView> views) const;

  void launch(Part part);
  void enqueue_repeats();
  bool retire_one(bool wait);
  void retire(bool wait);

  TrainStepOptions options_;
  device::Stream stream_;
  DeviceGaussians gaussians_;
  AdamState adam_;
  device::Buffer<float> learning_rate_;
  Workspace workspace_;
  int page_indices_ = 0;                                    // that there is room for, of a model in pages
  std::map<std::tuple<int, int, int>, ViewBatch> batches_;  // by width, height, views

  // Launches on their way, oldest first; what they leave for the host is in a ring.
  std::deque<Part> in_flight_;
  std::array<cudaEvent_t, ViewBatch::kStepsInFlight> done_{};
  device::Pinned<StepCounts> host_counts_{ViewBatch::kStepsInFlight};
  std::size_t launched_ = 0, retired_ = 0;
  std::deque<Part> repeats_;  // for whose intersections there was no room
  LossHistory loss_history_;
  Report report_;
  Clock::time_point busy_since_{};

  std::vector<TrainView> last_views_;
  WorkspaceView last_workspace_;
};

}  // namespace splatbus::raster::cuda
