#include "trainer/cuda/cuda_optimizer.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <utility>
#include <vector>

#include "device/buffer.h"
#include "raster/cuda/train_step.h"
#include "trainer/average.h"
#include "trainer/cuda/column_kernels.h"
#include "trainer/cuda/device_densifier.h"
#include "trainer/cuda/prune_check.h"
#include "trainer/cuda/step_kernels.h"

namespace splatbus::trainer {

namespace {

using device::check;

// At more than a thousand steps a second, held-out views get worse after a while unless rates fall early.
constexpr float kDefaultHalfRateSteps = 200;
constexpr int kDefaultBatch = 2;  // takes a quarter longer than one view, and 200 steps of it are worth 300

raster::cuda::TrainStepOptions train_options(const Options& options) {
  return {.project = {.antialias = options.antialias},
          .ssim_weight = options.ssim_weight,
          .albedo_weight = options.albedo_weight,
          .depth_weight = options.depth_weight / options.scene_extent_m,
          .statistics = options.densify.enabled,
          .active_channels = active_channels(options),
          .unit_albedo = options.layout.appearance == Appearance::Transfer,
          .half_rate_steps = options.lr_half_life_steps,
          .least_rate = options.lr_min_factor};
}

std::vector<raster::cuda::TrainView> train_views(std::span<const TrainingViewPtr> views) {
  std::vector<raster::cuda::TrainView> out;
  for (const TrainingViewPtr& view : views) {
    if (view->memory != Device::Cuda) throw std::invalid_argument("a picture is not in device memory");
    out.push_back({.view = {.camera = view->camera, .scene = &view->scene},
                   .color = view->color.data(),
                   .albedo = view->albedo.empty() ? nullptr : view->albedo.data(),
                   .depth = view->depth.empty() ? nullptr : view->depth.data(),
                   .keep = view});
  }
  return out;
}

class CudaOptimizer final : public Optimizer {
 public:
  CudaOptimizer(ModelStore& store, const Options& options)
      : Optimizer(store),
        train_(train_options(options)),
        pruning_(train_.stream()),
        densifier_(options.seed, train_.stream()) {
    check(cudaEventCreateWithFlags(&visibility_read_, cudaEventDisableTiming), "making an event");
    train_.set_model(gaussians());
    set_options(options);
    // An adopted model is taken for old: its average is settled.
    birth_.resize(store.capacity());
    birth_.clear(train_.stream());
    count_ = store.count();
  }

  ~CudaOptimizer() override {
    cudaStreamSynchronize(train_.stream());
    cudaEventDestroy(visibility_read_);
  }
  CudaOptimizer(const CudaOptimizer&) = delete;
  CudaOptimizer& operator=(const CudaOptimizer&) = delete;

  void set_options(const Options& options) override {
    options_ = options;
    if (options.batch == 0) options_.batch = kDefaultBatch;
    if (options.lr_half_life_steps < 0) options_.lr_half_life_steps = kDefaultHalfRateSteps;
    train_.set_options(train_options(options_));
    train_.set_learning_rates(channel_learning_rates(options));
  }

  StepReport step(std::span<const TrainingViewPtr> views) override {
    if (views.empty() || store_.count() == 0) return take_report();
    collect(false);
    if (pruning_.since() && store_.step() >= *pruning_.since() + kPruneLag && pruning_.wants_removal(store_.count())) {
      settle();
      if (store_.count() == 0) return take_report();
    }
    train_.step(train_views(views));
    store_.add_step(views.size(), std::exchange(unbooked_s_, 0.0));
    after_step();
    collect(false);
    return take_report();
  }

  StepReport finish() override {
    settle();
    store_.add_time(std::exchange(unbooked_s_, 0.0));
    return take_report();
  }

 private:
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

  /// What follows a step on the device: the average over time, and now and then a look for Gaussians to
  /// remove, to clone and to split.
  void after_step() {
    const std::uint64_t step = store_.step();
    const std::size_t stripe = step % TimeAverage::kStripes;
    cuda::launch_average(columns(),
                         {.begin = static_cast<int>(store_.count() * stripe / TimeAverage::kStripes),
                          .end = static_cast<int>(store_.count() * (stripe + 1) / TimeAverage::kStripes),
                          .step = step,
                          .settled_share = ema_weight(ema_decay(), TimeAverage::kStripes, ~0ULL),
                          .stripes = static_cast<float>(TimeAverage::kStripes)},
                         train_.stream());
    if (options_.prune.enabled && step % options_.prune.interval_steps == 0 && !pruning_.since()) {
      pruning_.search(columns(), options_.prune, step);
    }
    if (options_.densify.enabled && step % options_.densify.interval_steps == 0) densify();
  }

  void densify() {
    settle();
    const auto chosen = densifier_.choose(store_, train_.statistics(), options_.densify.gradient_threshold);
    train_.clear_statistics();
    const std::size_t added = std::min(chosen.size(), store_.room(store_.count()));
    if (added == 0) return;  // a change of structure costs every reader: not for nothing
    change([&] { densifier_.densify(store_, chosen, options_.densify); });
  }

  /// Takes in the figures of steps that are done; of all of them, after waiting, with `wait`.
  void collect(bool wait) {
    const auto done = train_.finished(wait);
    unbooked_s_ += done.seconds;
    report_ += {.steps = done.steps, .views = done.views, .seconds = done.seconds, .loss = done.loss};
  }

  /// Waits for all that is under way, and ends it.
  void settle() {
    collect(true);
    check(cudaStreamSynchronize(train_.stream()), "waiting for the steps");
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
    if (pruning_.found_not_finite()) {
      spdlog::warn("optimizer: Gaussians that were not finite were removed at step {}", store_.step());
    }
  }

  void before_change() override { settle(); }

  void set_visibility(const VisibilityCommand& relit) override {
    if (relit.memory != Device::Cuda) throw std::invalid_argument("visibility is not in device memory");
    check(cudaEventSynchronize(visibility_read_), "waiting for the visibility before");
    cuda::launch_set_visibility(store_.planes(), reinterpret_cast<const float*>(relit.visibility.get()),
                                static_cast<std::uint32_t>(relit.count), train_.stream());
    check(cudaEventRecord(visibility_read_, train_.stream()), "recording an event");
    visibility_ = relit.visibility;
  }

  void follow_growth() override {
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
  }

  StepReport take_report() { return std::exchange(report_, {}); }

  raster::cuda::TrainStep train_;
  device::Buffer<std::uint64_t> birth_;
  std::size_t count_ = 0;  // of Gaussians whose birth is known
  PruneCheck pruning_;
  DeviceDensifier densifier_;
  cudaEvent_t visibility_read_ = nullptr;
  std::shared_ptr<const std::byte> visibility_;  // kept until the device has read it
  StepReport report_;
  double unbooked_s_ = 0;  // of optimizer time that the model's figures do not have yet
};

}  // namespace

std::unique_ptr<Optimizer> make_cuda_optimizer(ModelStore& store, const Options& options) {
  return std::make_unique<CudaOptimizer>(store, options);
}

}  // namespace splatbus::trainer
