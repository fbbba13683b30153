#include <cstdint>
#include <optional>
#include <stdexcept>
#include <utility>
#include <vector>

#include "raster/cuda/train_step.h"
#include "trainer/gradient_step.h"

namespace splatbus::trainer {

namespace {

// At more than a thousand steps a second, held-out views get worse after a while unless rates fall early.
constexpr float kHalfRateStepsOnDevice = 200;
constexpr int kDefaultBatch = 2;  // takes a quarter longer than one view, and 200 steps of it are worth 300
// At this pace pages are seen often enough, and looking at them costs a hundredth.
constexpr int kLookInterval = 4;

raster::cuda::TrainStepOptions train_options(const Options& options) {
  return {.project = {.antialias = options.antialias},
          .ssim_weight = options.ssim_weight,
          .albedo_weight = options.albedo_weight,
          .depth_weight = options.depth_weight / options.scene_extent_m,
          .statistics = options.densify.enabled,
          .active_channels = active_channels(options),
          .unit_albedo = options.layout.appearance == Appearance::Transfer,
          .lr_half_life_steps = options.lr_half_life_steps,
          .lr_min_factor = options.lr_min_factor,
          .lr_recovery = options.lr_recovery,
          .mask_opacity = options.mask_opacity,
          .look_interval = options.freeze.enabled ? kLookInterval : 0};
}

/// As many of the first as have a place for all their objects, be they others in each.
std::span<const PairedView> with_room(std::span<const PairedView> views) {
  std::size_t objects = 1, count = 0;
  for (; count < views.size(); ++count) {
    objects += views[count].view->scene.objects.size();
    if (count > 0 && objects >= static_cast<std::size_t>(raster::cuda::kMaxObjects)) break;
  }
  return views.first(count);
}

std::vector<raster::cuda::TrainView> train_views(std::span<const PairedView> views, bool cull_hidden) {
  std::vector<raster::cuda::TrainView> out;
  for (const PairedView& paired : views) {
    const TrainingViewPtr& view = paired.view;
    if (view->memory != Device::Cuda) throw std::invalid_argument("a picture is not in device memory");
    out.push_back({.view = {.camera = view->camera,
                            .scene = &view->scene,
                            .visibility = paired.visibility.values.get(),
                            .visibility_stride = paired.visibility.stride,
                            .visibility_rows = paired.visibility.rows,
                            .hidden_behind = cull_hidden ? view->farthest_surfaces() : FarthestSurfaces{}},
                   .color = view->color.data(),
                   .albedo = view->albedo.empty() ? nullptr : view->albedo.data(),
                   .depth = view->depth.empty() ? nullptr : view->depth.data(),
                   .mask = view->mask.data(),
                   .keep = std::make_shared<const PairedView>(paired)});
  }
  return out;
}

class CudaStep final : public GradientStep {
 public:
  CudaStep(model::PageStore& store, const Options& options)
      : store_(store), cull_(options.cull), cull_hidden_(options.cull_hidden), train_(train_options(options)) {
    train_.set_model(gaussians(), store.view().ranges);
  }
  ~CudaStep() override { cudaStreamSynchronize(train_.stream()); }

  void set_options(Options& options) override {
    if (options.batch == 0) options.batch = kDefaultBatch;
    if (options.lr_half_life_steps < 0) options.lr_half_life_steps = kHalfRateStepsOnDevice;
    train_.set_options(train_options(options));
    train_.set_learning_rates(channel_learning_rates(options));
  }

  void step(std::span<const PairedView> views) override { train_.step(train_views(with_room(views), cull_hidden_)); }

  StepReport finished(bool wait) override {
    auto done = train_.finished(wait);
    StepReport report{.steps = done.steps,
                      .views = done.views,
                      .seconds = done.seconds,
                      .loss = done.loss,
                      .masked_share = done.masked_share,
                      .looks = {}};
    for (raster::cuda::TrainStep::Look& look : done.looks) {
      std::optional<float> share;
      if (look.looked) share = active_share(look.pages, store_.table());
      report.looks.push_back({.view = std::static_pointer_cast<const PairedView>(look.keep)->view,
                              .loss = look.loss,
                              .pages = std::move(look.pages),
                              .active_share = share});
    }
    return report;
  }

  void follow(std::span<const IndexRange> fresh, const model::Moves& moves) override {
    train_.follow_model(
        gaussians(),
        {.ranges = store_.view().ranges, .fresh = fresh, .from = moves.from, .to = moves.to, .moves = moves.count});
  }

  [[nodiscard]] raster::PageMoments moments_of(std::uint32_t page) const override {
    return train_.moments().moments_of(page);
  }
  void save_moments(std::uint32_t page, float* moments) const override {
    train_.moments().save(page, moments, train_.stream());
  }
  void restore_moments(std::uint32_t page, raster::PageMoments kind, const float* moments) override {
    train_.moments().restore(page, kind, moments, train_.stream());
  }
  [[nodiscard]] kernels::ScreenStatistics statistics() const override {
    const raster::cuda::ScreenStatistics gathered = train_.statistics();
    return {.mean2d_norm = gathered.mean2d_norm, .steps = gathered.steps};
  }
  void clear_statistics() override { train_.clear_statistics(); }
  [[nodiscard]] device::StreamView stream() const override { return {Device::Cuda, train_.stream()}; }

 private:
  [[nodiscard]] raster::cuda::DeviceGaussians gaussians() const {
    const GaussiansView view = store_.view();
    return {.layout = view.layout,
            .count = static_cast<int>(view.count),
            .stride = static_cast<std::int64_t>(view.stride),
            .page_shift = view.page_shift,
            .page_stride = static_cast<std::int64_t>(view.page_stride),
            .ranges = store_.device_ranges(),
            .bounds = cull_ ? store_.device_bounds() : nullptr,
            .range_count = static_cast<int>(view.ranges.size()),
            .parameters = store_.parameters(),
            .normal = view.normal,
            .visibility = view.visibility};
  }

  model::PageStore& store_;
  const bool cull_, cull_hidden_;
  raster::cuda::TrainStep train_;
};

}  // namespace

std::unique_ptr<GradientStep> make_cuda_step(model::PageStore& store, const Options& options) {
  return std::make_unique<CudaStep>(store, options);
}

}  // namespace splatbus::trainer
