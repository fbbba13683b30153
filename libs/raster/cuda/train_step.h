#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
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
#include "raster/rasterizer.h"

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
  /// Pixels of views with depth that nothing models yet count as masked (raster/unmodelled.h); 0: none.
  float mask_opacity = 0;
  int look_interval = 0;  ///< steps from one that says what its views show of pages to the next; 0: none does
  bool training = true;   ///< false: forward() only, and no memory for more; pictures may be null
};

/// Render, loss, backward, Adam on device memory, without a host synchronisation inside a step. A few steps may be on
/// their way at once; step() waits for the oldest when they are too many. A step that finds more intersections of
/// Gaussians with tiles than there is room for changes nothing; the room grows as soon as that is known, and the step
/// comes again.
///
/// The arrays of a step grow with its pictures (65 bytes a pixel, 24 more with albedo, 12 with depth), with its
/// intersections (24 bytes each, 16 more with albedo or depth) and with views times Gaussians that any of them sees (85
/// bytes; page by page). Pictures of all sizes take turns in them.
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
  /// The model to train in place, device memory, object_id too (null: all static). Adam's moments begin anew. `ranges`:
  /// as in ModelChange.
  void set_model(const DeviceGaussians& gaussians, std::span<const IndexRange> ranges = {});
  /// The same model after a change of its structure, of the same layout, channels perhaps elsewhere and with another
  /// stride. Columns below both counts keep their moments and statistics, but for what the change says; others begin
  /// without. Frozen ranges give their moments back. The change's device arrays are read by stream().
  void follow_model(const DeviceGaussians& gaussians, const ModelChange& change = {});
  /// One rate a channel.
  void set_learning_rates(const std::vector<float>& rates);

  /// Enqueues one step on stream(). Views that differ in size, and more of them than fit a launch (kMaxBatch and
  /// kMaxPixels), are trained one part after the other, small pictures first. Throws std::invalid_argument for a
  /// picture of more than kMaxPixels.
  void step(std::span<const TrainView> views);
  /// Only draws them. A picture for whose intersections there was no room is not complete.
  void forward(std::span<const TrainView> views);

  /// What a step saw in one of its views.
  struct Look {
    std::shared_ptr<const void> keep;  ///< the view's
    float loss = 0;
    bool looked = false;          ///< at pages
    std::vector<PageLook> pages;  ///< ascending; errors in display space
  };
  /// Steps that came to their end.
  struct Report {
    std::size_t steps = 0, views = 0;
    double loss = 0;          ///< mean over the views
    double masked_share = 0;  ///< of their pixels, by mask_opacity
    double seconds = 0;       ///< in which they were on their way
    std::vector<Look> looks;
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
  /// What Adam keeps of the model's pages; on stream(), as AdamState has it.
  [[nodiscard]] AdamState& moments() { return adam_; }
  [[nodiscard]] const AdamState& moments() const { return adam_; }
  [[nodiscard]] cudaStream_t stream() const { return stream_.get(); }
  [[nodiscard]] std::size_t bytes() const;  ///< device memory that it owns
  /// Of Adam's moments, the part that pages have.
  [[nodiscard]] std::size_t moment_bytes() const { return adam_.block_bytes(); }

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
    bool training = true, ends_step = false, looks = false;
    ViewBatch* batch = nullptr;
    std::uint32_t isect_capacity = 0, list_capacity = 0;  // of its launch
    std::size_t pages = 0;                                // that it looks at
  };

  [[nodiscard]] static std::vector<Part> split(std::span<const TrainView> views);
  ViewBatch& batch_for(std::span<const TrainView> views);
  WorkspaceView workspace_for(ViewBatch& batch);
  void size_lists(ViewBatch& batch);
  void invalidate_graphs();

  void enqueue_forward(const ViewBatch& batch, const WorkspaceView& w);
  void picture_loss(const float* rendered, const ViewBatch& batch, bool of_albedo, float* gradient,
                    const WorkspaceView& w);
  void losses(const ViewBatch& batch, const WorkspaceView& w);
  [[nodiscard]] static ViewMasks masks_of(const ViewBatch& batch, const WorkspaceView& w);
  void look_at_pages(const ViewBatch& batch, const WorkspaceView& w, std::size_t slot);
  [[nodiscard]] std::size_t page_count() const;
  void report(const Part& part, std::size_t slot);
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
  std::map<std::tuple<int, int, int>, ViewBatch> batches_;  // by width, height, views

  // Launches on their way, oldest first; what they leave for the host is in a ring.
  std::deque<Part> in_flight_;
  std::array<cudaEvent_t, ViewBatch::kStepsInFlight> done_{};
  device::Pinned<StepCounts> host_counts_{ViewBatch::kStepsInFlight};
  // Of the pages that views show, [kStepsInFlight][look_room_] on the host: what they show.
  device::Buffer<PageSums> sums_;
  device::Pinned<PageSums> host_sums_;
  std::size_t look_room_ = 0;
  int steps_to_look_ = 0;
  std::size_t launched_ = 0, retired_ = 0;
  std::deque<Part> repeats_;  // for whose intersections there was no room
  LossHistory loss_history_;
  Report report_;
  Clock::time_point busy_since_{};

  std::vector<TrainView> last_views_;
  WorkspaceView last_workspace_;
};

}  // namespace splatbus::raster::cuda
