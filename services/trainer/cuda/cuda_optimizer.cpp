#include "trainer/cuda/cuda_optimizer.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <deque>
#include <map>
#include <optional>
#include <stdexcept>
#include <tuple>
#include <utility>
#include <vector>

#include "device/buffer.h"
#include "device/pinned.h"
#include "raster/cuda/train_step.h"
#include "trainer/average.h"
#include "trainer/cuda/cell_observer.h"
#include "trainer/cuda/prune_check.h"
#include "trainer/cuda/step_kernels.h"
#include "trainer/cuda/warm_up.h"

namespace splatbus::trainer {

namespace {

using device::check;
using Clock = std::chrono::steady_clock;

// At more than a thousand steps a second, held-out views get worse after a while unless rates fall early.
constexpr float kDefaultHalfRateSteps = 200;
constexpr std::size_t kMaxGroups = 32;
constexpr int kDefaultBatch = 2;  // takes a quarter longer than one view, and 200 steps of it are worth 300

raster::cuda::TrainStepOptions train_options(const Options& options) {
  return {.project = {.antialias = options.antialias},
          .ssim_weight = options.ssim_weight,
          .albedo_weight = options.albedo_weight,
          .active_channels = active_channels(options),
          .unit_albedo = options.layout.appearance == Appearance::Transfer,
          .half_rate_steps = options.half_rate_steps,
          .least_rate = options.least_rate};
}

raster::cuda::TrainView train_view(const TrainingView& view) {
  return {.view = {.camera = view.camera, .scene = &view.scene},
          .color = view.color.data(),
          .albedo = view.albedo.empty() ? nullptr : view.albedo.data()};
}

class CudaOptimizer final : public Optimizer {
 public:
  CudaOptimizer(ModelStore& store, const Options& options)
      : Optimizer(store), train_(train_options(options)), pruning_(train_.stream()) {
    warm_up(options.layout);
    train_.set_model(gaussians());
    set_options(options);
    // An adopted model is taken for old: its average is settled.
    birth_.resize(store.capacity());
    birth_.clear(train_.stream());
    count_ = store.count();
  }

  ~CudaOptimizer() override { cudaStreamSynchronize(train_.stream()); }
  CudaOptimizer(const CudaOptimizer&) = delete;
  CudaOptimizer& operator=(const CudaOptimizer&) = delete;

  void set_options(const Options& options) override {
    options_ = options;
    if (options.batch == 0) options_.batch = kDefaultBatch;
    if (options.half_rate_steps < 0) options_.half_rate_steps = kDefaultHalfRateSteps;
    train_.set_options(train_options(options_));
    train_.set_learning_rates(channel_learning_rates(options));
    if (options.depth_weight > 0 && !std::exchange(warned_depth_, true)) {
      spdlog::warn("depth_weight is not offered by the CUDA backend: training goes on without a depth loss");
    }
    if (options.densify.enabled && !std::exchange(warned_densify_, true)) {
      spdlog::warn("densify is not offered by the CUDA backend: training goes on without it");
    }
  }

  StepReport step(std::span<const TrainingViewPtr> views) override {
    if (views.empty() || store_.count() == 0) return take_report();
    collect(false);
    if (pruning_.since() && store_.step() >= *pruning_.since() + kPruneLag && pruning_.wants_removal(store_.count())) {
      settle();
      if (store_.count() == 0) return take_report();
    }
    for (Chunk& chunk : std::exchange(repeats_, {})) enqueue(std::move(chunk));
    for (Chunk& chunk : split(views)) enqueue(std::move(chunk));
    store_.add_step(views.size(), std::exchange(unbooked_s_, 0.0));
    after_step(chunks_.back().views.back());
    collect(false);
    return take_report();
  }

  StepReport finish() override {
    settle();
    store_.add_time(std::exchange(unbooked_s_, 0.0));
    return take_report();
  }

 private:
  /// Views that are trained at once: a whole step, or one of several parts of it.
  struct Chunk {
    std::vector<TrainingViewPtr> views;  // their pictures are kept until the device is done with them
    bool ends_step = false;
    int tries = 0;  // that changed nothing, for its lists did not fit
  };

  /// Lists grow with every try; what does not fit by then never will.
  static constexpr int kMostTries = 8;

  /// Steps between the search for Gaussians to remove and the look at what it found, which is there by then.
  static constexpr std::uint64_t kPruneLag = 3;

  [[nodiscard]] raster::cuda::DeviceGaussians gaussians() const {
    const ModelPlanes& planes = store_.planes();
    return {.layout = planes.layout,
            .count = static_cast<int>(store_.count()),
            .stride = static_cast<std::int64_t>(planes.capacity),
            .parameters = planes.parameters,
            .normal = planes.normal,
            .visibility = planes.visibility,
            .object_id = planes.object_id,
            .flags = planes.flags};
  }

  [[nodiscard]] cuda::Columns columns() const {
    const ModelPlanes& planes = store_.planes();
    return {.count = static_cast<int>(store_.count()),
            .stride = static_cast<std::int64_t>(planes.capacity),
            .parameters = planes.parameters,
            .average = planes.average,
            .flags = planes.flags,
            .birth = birth_.data(),
            .active_channels = active_channels(options_)};
  }

  static std::vector<Chunk> split(std::span<const TrainingViewPtr> views) {
    std::map<std::pair<std::uint32_t, std::uint32_t>, std::vector<TrainingViewPtr>> by_size;
    for (const TrainingViewPtr& view : views) {
      if (view->memory != bus::MemoryKind::Cuda) throw std::invalid_argument("a picture is not in device memory");
      by_size[{view->camera.width, view->camera.height}].push_back(view);
    }
    std::vector<Chunk> chunks;
    for (auto& [size, of_size] : by_size) {
      for (std::size_t first = 0; first < of_size.size(); first += raster::cuda::kMaxBatch) {
        const std::size_t end = std::min(of_size.size(), first + raster::cuda::kMaxBatch);
        chunks.push_back({.views = {of_size.begin() + static_cast<std::ptrdiff_t>(first),
                                    of_size.begin() + static_cast<std::ptrdiff_t>(end)}});
      }
    }
    chunks.back().ends_step = true;
    return chunks;
  }

  void enqueue(Chunk chunk) {
    if (!followed_) follow_growth();
    if (chunks_.empty()) busy_since_ = Clock::now();
    std::vector<raster::cuda::TrainView> views;
    for (const TrainingViewPtr& view : chunk.views) views.push_back(train_view(*view));
    train_.step(group_for(views));
    chunks_.push_back(std::move(chunk));  // last: what could not be enqueued is not waited for
  }

  /// The group of these views' size, with them in it.
  std::size_t group_for(std::span<const raster::cuda::TrainView> views) {
    const Camera& camera = views[0].view.camera;
    const GroupKey key{camera.width, camera.height, views.size()};
    if (const auto found = groups_.find(key); found != groups_.end()) {
      train_.renew_group(found->second, views);
      return found->second;
    }
    if (groups_.size() >= kMaxGroups) {
      train_.clear_groups();
      groups_.clear();
    }
    return groups_[key] = train_.add_group(views);
  }

  /// What follows a step on the device: the average over time, and now and then a look at cells and for Gaussians to
  /// remove. `last` is the last view that was enqueued, whose pictures the workspace holds.
  void after_step(const TrainingViewPtr& last) {
    const std::uint64_t step = store_.step();
    const std::size_t stripe = step % TimeAverage::kStripes;
    cuda::launch_average(columns(),
                         {.begin = static_cast<int>(store_.count() * stripe / TimeAverage::kStripes),
                          .end = static_cast<int>(store_.count() * (stripe + 1) / TimeAverage::kStripes),
                          .step = step,
                          .settled_share = average_share(average_decay(), TimeAverage::kStripes, ~0ULL),
                          .stripes = static_cast<float>(TimeAverage::kStripes)},
                         train_.stream());
    if (observer_.due()) {
      const raster::cuda::WorkspaceView& w = train_.workspace();
      observer_.observe(gaussians(), columns(), store_.planes().cell,
                        {.workspace = w,
                         .view = w.batch - 1,
                         .target = last->color.data(),
                         .display_space = options_.layout.appearance == Appearance::Radiance},
                        train_.stream());
      observed_ = last;
    }
    if (options_.prune.enabled && step % options_.prune.interval_steps == 0 && !pruning_.since()) {
      pruning_.search(columns(), options_.prune, step);
    }
  }

  /// Takes in the figures of steps that are done; of all of them, after waiting, with `wait`.
  void collect(bool wait) {
    const auto reports = train_.finished(wait);
    for (const auto& report : reports) {
      Chunk chunk = std::move(chunks_.front());
      chunks_.pop_front();
      if (!report.changed) {
        repeat(std::move(chunk));
        continue;
      }
      report_.steps += chunk.ends_step ? 1 : 0;
      report_.views += chunk.views.size();
      report_.loss += double{report.loss} * static_cast<double>(chunk.views.size());
    }
    if (!reports.empty()) book_time();
    observer_.collect(wait, cells_);
  }

  void repeat(Chunk chunk) {
    if (++chunk.tries < kMostTries) return repeats_.push_back(std::move(chunk));
    if (!std::exchange(warned_lists_, true)) {
      spdlog::error("optimizer: Gaussians cover more tiles of pictures than can be listed: such steps are left out");
    }
  }

  void book_time() {
    const Clock::time_point now = Clock::now();
    const double seconds = std::chrono::duration<double>(now - busy_since_).count();
    busy_since_ = now;
    report_.seconds += seconds;
    unbooked_s_ += seconds;
  }

  /// Waits for all that is under way, and ends it.
  void settle() {
    if (!followed_) follow_growth();
    do {
      check(cudaStreamSynchronize(train_.stream()), "waiting for the steps");
      collect(true);
      for (Chunk& chunk : std::exchange(repeats_, {})) enqueue(std::move(chunk));
    } while (!chunks_.empty());
    if (!pruning_.since()) return;
    const bool removal = pruning_.wants_removal(store_.count());
    pruning_.forget();
    if (removal) remove();
  }

  void remove() {
    ColumnMoves moves;
    store_.change([&] { moves = store_.remove(pruning_.dead()); });
    const auto moved = static_cast<int>(moves.moved);
    train_.move_columns(moves.from, moves.to, moved);
    cuda::launch_move_birth(birth_.data(), moves.from, moves.to, moved, train_.stream());
    train_.follow_model(gaussians());
    // The moves are gone with the next change.
    check(cudaStreamSynchronize(train_.stream()), "removing Gaussians");
    count_ = store_.count();
    observer_.structure_changed();
    if (pruning_.found_not_finite()) {
      spdlog::warn("optimizer: Gaussians that were not finite were removed at step {}", store_.step());
    }
  }

  void before_change() override { settle(); }

  void follow_growth() override {
    followed_ = false;
    cudaStream_t stream = train_.stream();
    if (birth_.size() != store_.capacity()) {
      device::Buffer<std::uint64_t> birth(store_.capacity());
      check(cudaMemcpyAsync(birth.data(), birth_.data(), count_ * sizeof(std::uint64_t), cudaMemcpyDeviceToDevice,
                            stream),
            "moving ages");
      check(cudaStreamSynchronize(stream), "moving ages");
      birth_ = std::move(birth);
    }
    cuda::launch_set_birth(birth_.data(), static_cast<int>(count_), static_cast<int>(store_.count()), store_.step(),
                           stream);
    count_ = store_.count();
    train_.follow_model(gaussians());
    observer_.structure_changed();
    followed_ = true;
  }

  StepReport take_report() {
    StepReport report = std::exchange(report_, {});
    if (report.views > 0) report.loss /= static_cast<double>(report.views);
    return report;
  }

  using GroupKey = std::tuple<std::uint32_t, std::uint32_t, std::size_t>;  // width, height, views

  raster::cuda::TrainStep train_;
  std::map<GroupKey, std::size_t> groups_;
  std::deque<Chunk> chunks_;    // under way
  std::vector<Chunk> repeats_;  // whose lists did not fit: they are trained again
  device::Buffer<std::uint64_t> birth_;
  std::size_t count_ = 0;  // of Gaussians whose birth is known
  bool followed_ = true;   // the model's last change; else there was no memory for that, and it is tried again
  CellObserver observer_;
  TrainingViewPtr observed_;  // kept until the device has looked at it
  PruneCheck pruning_;
  StepReport report_;      // loss summed over views
  double unbooked_s_ = 0;  // of optimizer time that the model's figures do not have yet
  Clock::time_point busy_since_{};
  bool warned_depth_ = false, warned_densify_ = false, warned_lists_ = false;
};

}  // namespace

std::unique_ptr<Optimizer> make_cuda_optimizer(ModelStore& store, const Options& options) {
  return std::make_unique<CudaOptimizer>(store, options);
}

}  // namespace splatbus::trainer
