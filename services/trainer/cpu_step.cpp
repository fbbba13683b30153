#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>
#include <vector>

#include "raster/adam.h"
#include "raster/loss.h"
#include "raster/loss_history.h"
#include "raster/rasterizer.h"
#include "raster/unmodelled.h"
#include "trainer/gradient_step.h"
#include "trainer/unmodelled.h"

namespace splatbus::trainer {

namespace {

// At tens of steps a second a live scene is learned all the while.
constexpr float kDefaultHalfRateSteps = 1000;

void scale_image(raster::Image& image, float factor) {
  if (factor == 1.0F) return;
  for (float& value : image.data) value *= factor;
}

class CpuStep final : public GradientStep {
 public:
  CpuStep(model::PageStore& store, const Options& options)
      : store_(store), rasterizer_(raster::make_cpu_rasterizer(options.threads)) {
    resize(store.view().count);
  }

  void set_options(Options& options) override;
  void step(std::span<const PairedView> views) override;
  StepReport finished(bool /*wait*/) override { return std::exchange(report_, {}); }
  void follow(std::span<const IndexRange> fresh, const model::Moves& moves) override;
  [[nodiscard]] raster::PageMoments moments_of(std::uint32_t page) const override { return adam_.moments_of(page); }
  void save_moments(std::uint32_t page, float* moments) const override { adam_.save(page, moments); }
  void restore_moments(std::uint32_t page, raster::PageMoments kind, const float* moments) override {
    adam_.restore(page, kind, moments);
  }
  [[nodiscard]] kernels::ScreenStatistics statistics() const override {
    return {.mean2d_norm = mean2d_norm_.data(), .steps = seen_steps_.data()};
  }
  void clear_statistics() override;
  [[nodiscard]] device::StreamView stream() const override { return {}; }

 private:
  void resize(std::size_t count);
  void renew_bounds();
  /// Renders the view; the loss and, in render_gradient_, its gradient, both times `scale`.
  double render_loss(const PairedView& paired, float scale);
  /// Of the view, and what nothing models yet; null: none. Adds `share` of the part that the latter has to
  /// masked_share_.
  const std::uint8_t* mask_of(const TrainingView& view, float share);
  void look(const TrainingViewPtr& view, float loss);
  float depth_loss(const TrainingView& view, float scale);
  void observe();

  model::PageStore& store_;
  Options options_;
  std::vector<float> learning_rates_;
  std::unique_ptr<raster::Rasterizer> rasterizer_;
  raster::Adam adam_;
  raster::ParameterGradient gradient_;
  raster::Render render_;
  raster::RenderGradient render_gradient_;
  raster::Image error_;
  std::vector<std::uint8_t> mask_;
  std::vector<float> near_opacity_;
  float masked_share_ = 0;                   ///< of the step
  const std::uint8_t* view_mask_ = nullptr;  ///< of the last view: its own or mask_
  raster::LossHistory losses_;
  std::vector<float> mean2d_norm_;
  std::vector<std::uint32_t> seen_steps_;
  StepReport report_;
  int bounded_steps_ = 0;  ///< steps that the store's bounds have held for
};

void CpuStep::set_options(Options& options) {
  options.batch = std::max(1, options.batch);
  if (options.lr_half_life_steps < 0) options.lr_half_life_steps = kDefaultHalfRateSteps;
  options_ = options;
  bounded_steps_ = 0;
  learning_rates_ = channel_learning_rates(options);
  gradient_.active_channels = active_channels(options);
  adam_.lr_half_life_steps = options.lr_half_life_steps;
  adam_.lr_min_factor = options.lr_min_factor;
  adam_.unit_albedo = options.layout.appearance == Appearance::Transfer;
}

void CpuStep::step(std::span<const PairedView> views) {
  const auto start = std::chrono::steady_clock::now();
  double loss = 0;
  masked_share_ = 0;
  adam_.views.clear();
  if (views.size() == 1) {
    gradient_.clear_statistics(store_.view());
    loss = render_loss(views.front(), 1.0F);
    rasterizer_->backward_step(render_gradient_, learning_rates_, adam_, store_.parameters(), gradient_);
  } else {
    gradient_.clear(store_.view(), options_.threads);
    for (const PairedView& view : views) {
      loss += render_loss(view, 1.0F / static_cast<float>(views.size()));
      rasterizer_->backward(render_gradient_, gradient_);
    }
    adam_.step(store_.view(), store_.parameters(), gradient_, learning_rates_, options_.threads);
  }
  renew_bounds();
  const std::chrono::duration<double> spent = std::chrono::steady_clock::now() - start;
  if (options_.densify.enabled) observe();
  report_ += {.steps = 1,
              .views = views.size(),
              .seconds = spent.count(),
              .loss = loss,
              .masked_share = masked_share_,
              .looks = {}};
}

void CpuStep::renew_bounds() {
  constexpr int kHoldSteps = 8;
  if (bounded_steps_++ % kHoldSteps != 0) return;
  bounded_steps_ = 1;
  // Adam moves a parameter by at most its rate times (1 - beta1) / sqrt(1 - beta2) (Kingma and Ba 2015, 2.1).
  const float most = kHoldSteps * std::max(1.0F, (1 - adam_.beta1) / std::sqrt(1 - adam_.beta2));
  store_.refresh_bounds(most * learning_rates_[ParameterLayout::kMean],
                        std::exp(most * learning_rates_[ParameterLayout::kLogScale]));
}

void CpuStep::follow(std::span<const IndexRange> fresh, const model::Moves& moves) {
  bounded_steps_ = 0;
  const std::size_t count = store_.view().count;
  resize(std::max(count, seen_steps_.size()));  // what moves may come from beyond the new end
  for (const IndexRange& range : fresh) {
    adam_.reset(range.first, range.count);
    std::fill_n(mean2d_norm_.begin() + range.first, range.count, 0.0F);
    std::fill_n(seen_steps_.begin() + range.first, range.count, 0U);
  }
  adam_.move({moves.from, moves.count}, {moves.to, moves.count});
  for (std::size_t k = 0; k < moves.count; ++k) {
    mean2d_norm_[moves.to[k]] = mean2d_norm_[moves.from[k]];
    seen_steps_[moves.to[k]] = seen_steps_[moves.from[k]];
  }
  resize(count);
  adam_.keep(store_.view().ranges);
}

void CpuStep::resize(std::size_t count) {
  adam_.resize(store_.layout(), count);
  mean2d_norm_.resize(count, 0.0F);
  seen_steps_.resize(count, 0U);
}

void CpuStep::clear_statistics() {
  std::fill(mean2d_norm_.begin(), mean2d_norm_.end(), 0.0F);
  std::fill(seen_steps_.begin(), seen_steps_.end(), 0U);
}

void CpuStep::observe() {
  for (std::size_t i = 0; i < gradient_.count; ++i) {
    if (gradient_.touched[i] == 0) continue;
    mean2d_norm_[i] += gradient_.mean2d_norm[i];
    seen_steps_[i] += 1;
  }
}

double CpuStep::render_loss(const PairedView& paired, float scale) {
  const TrainingView& view = *paired.view;
  const bool with_albedo = options_.albedo_weight > 0 && !view.albedo.empty();
  const bool with_depth = options_.depth_weight > 0 && !view.depth.empty();
  const raster::RenderOptions render_options{
      .antialias = options_.antialias,
      .albedo = with_albedo,
      .depth = with_depth,
      .hidden_behind = options_.cull_hidden ? view.farthest_surfaces() : FarthestSurfaces{}};
  GaussiansView gaussians = store_.view();
  if (!options_.cull) gaussians.bounds = {};
  gaussians.visibility_u8 = paired.visibility.values.get();
  gaussians.visibility_stride = paired.visibility.stride;
  gaussians.visibility_rows = paired.visibility.rows;
  rasterizer_->forward(gaussians, view.camera, view.scene, render_options, render_);

  view_mask_ = mask_of(view, scale);
  render_gradient_.alpha = {};
  render_gradient_.albedo = {};
  render_gradient_.depth = {};
  raster::LossOptions loss_options{.ssim_weight = options_.ssim_weight,
                                   .encode_srgb = options_.layout.appearance == Appearance::Transfer,
                                   .mask = view_mask_,
                                   .threads = options_.threads};
  float loss = image_loss(render_.color, view.color.data(), loss_options, render_gradient_.color);
  scale_image(render_gradient_.color, scale);
  if (with_albedo) {
    loss +=
        options_.albedo_weight * image_loss(render_.albedo, view.albedo.data(), loss_options, render_gradient_.albedo);
    scale_image(render_gradient_.albedo, scale * options_.albedo_weight);
  }
  if (with_depth) loss += depth_loss(view, scale);
  render_gradient_.surface_depth = view.depth.empty() ? nullptr : view.depth.data();
  adam_.views.push_back({.camera = view.camera,
                         .objects = &view.scene.objects,
                         .loss_has_risen = options_.lr_recovery && loss > losses_.limit(view.camera)});
  losses_.add(view.camera, loss);
  look(paired.view, loss);
  return loss * scale;
}

const std::uint8_t* CpuStep::mask_of(const TrainingView& view, float share) {
  if (view.depth.empty() || !(options_.mask_opacity > 0)) return view.mask.data();
  near_opacity_.clear();
  if (view.scene.objects.contains(kFarFieldFrame)) {
    rasterizer_->opacity_within(raster::kNearerThanFarField_m, near_opacity_);
  }
  const std::size_t masked = mask_unmodelled(render_.alpha, view, options_.mask_opacity, near_opacity_, mask_);
  if (masked == 0) return view.mask.data();
  masked_share_ += share * static_cast<float>(masked) / static_cast<float>(mask_.size());
  return mask_.data();
}

void CpuStep::look(const TrainingViewPtr& view, float loss) {
  report_.looks.push_back({.view = view, .loss = loss, .pages = {}, .active_share = {}});
  if (!options_.freeze.enabled) return;
  l1_error(render_.color, view->color.data(), options_.layout.appearance == Appearance::Transfer, view_mask_, error_);
  ViewLook& look = report_.looks.back();
  rasterizer_->look_at_pages(error_, look.pages);
  look.active_share = active_share(look.pages, store_.table());
}

float CpuStep::depth_loss(const TrainingView& view, float scale) {
  // mean |sum w (z - z_engine)| / extent over pixels with a surface: linear in depth and alpha, and 0 only where every
  // Gaussian in front balances about the surface.
  const std::uint32_t w = view.camera.width;
  const std::uint32_t h = view.camera.height;
  render_gradient_.depth = raster::Image(w, h, 1);
  render_gradient_.alpha = raster::Image(w, h, 1);
  const float weight = options_.depth_weight / (options_.scene_extent_m * static_cast<float>(view.depth.size()));
  double loss = 0;
  for (std::size_t i = 0; i < view.depth.size(); ++i) {
    const float expected = view.depth[i];
    if (!(expected > 0) || std::isinf(expected) || (view_mask_ != nullptr && view_mask_[i] != 0)) continue;
    const float difference = render_.depth.data[i] - render_.alpha.data[i] * expected;
    loss += std::abs(difference) * weight;
    const float slope = std::copysign(weight * scale, difference);
    render_gradient_.depth.data[i] = slope;
    render_gradient_.alpha.data[i] = -slope * expected;
  }
  return static_cast<float>(loss);
}

}  // namespace

std::unique_ptr<GradientStep> make_cpu_step(model::PageStore& store, const Options& options) {
  return std::make_unique<CpuStep>(store, options);
}

}  // namespace splatbus::trainer
