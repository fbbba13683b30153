#include "trainer/cpu_optimizer.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <chrono>
#include <cmath>

#include "raster/loss.h"

namespace splatbus::trainer {

namespace {

// At tens of steps a second a live scene is learned all the while.
constexpr float kDefaultHalfRateSteps = 1000;

void scale_image(raster::Image& image, float factor) {
  if (factor == 1.0F) return;
  for (float& value : image.data) value *= factor;
}

}  // namespace

CpuOptimizer::CpuOptimizer(ModelStore& store, const Options& options)
    : Optimizer(store), rasterizer_(raster::make_cpu_rasterizer(options.threads)), densifier_(options.seed) {
  CpuOptimizer::set_options(options);
  // An adopted model is taken for old: its average is settled.
  created_step_.assign(store.count(), 0);
  CpuOptimizer::follow_growth();
}

void CpuOptimizer::set_options(const Options& options) {
  options_ = options;
  options_.batch = std::max(1, options.batch);
  if (options.lr_half_life_steps < 0) options_.lr_half_life_steps = kDefaultHalfRateSteps;
  active_channels_ = active_channels(options);
  learning_rates_ = channel_learning_rates(options);
  adam_.half_rate_steps = options_.lr_half_life_steps;
  adam_.least_rate = options.lr_min_factor;
}

void CpuOptimizer::follow_growth() {
  adam_.resize(store_.layout(), store_.count());
  created_step_.resize(store_.count(), store_.step());
  densifier_.resize(store_.count());
}

void CpuOptimizer::set_visibility(const VisibilityCommand& relit) {
  store_.set_visibility(relit.model_generation, reinterpret_cast<const float*>(relit.visibility.get()), relit.memory,
                        relit.count);
}

StepReport CpuOptimizer::step(std::span<const TrainingViewPtr> views) {
  if (views.empty() || store_.count() == 0) return {};
  const auto start = std::chrono::steady_clock::now();
  gradient_.active_channels = active_channels_;
  float* const parameters = store_.planes().parameters;
  double loss = 0;
  if (views.size() == 1) {
    gradient_.clear_statistics(store_.view());
    loss = render_loss(*views.front(), 1.0F);
    rasterizer_->backward_step(render_gradient_, learning_rates_, adam_, parameters, gradient_);
  } else {
    gradient_.clear(store_.view(), options_.threads);
    for (const auto& view : views) {
      loss += render_loss(*view, 1.0F / static_cast<float>(views.size()));
      rasterizer_->backward(render_gradient_, gradient_);
    }
    adam_.step(store_.view(), parameters, gradient_, learning_rates_, options_.threads);
  }
  if (options_.layout.appearance == Appearance::Transfer) clamp_albedo();
  const std::chrono::duration<double> spent = std::chrono::steady_clock::now() - start;
  store_.add_step(views.size(), spent.count());

  average_.update(store_.planes(), store_.count(), active_channels_, created_step_, store_.step(), ema_decay());
  maintain_density();
  return {.steps = 1, .views = views.size(), .seconds = spent.count(), .loss = loss};
}

double CpuOptimizer::render_loss(const TrainingView& view, float scale) {
  const bool with_albedo = options_.albedo_weight > 0 && !view.albedo.empty();
  const bool with_depth = options_.depth_weight > 0 && !view.depth.empty();
  const raster::RenderOptions render_options{
      .antialias = options_.antialias, .albedo = with_albedo, .depth = with_depth};
  rasterizer_->forward(store_.view(), view.camera, view.scene, render_options, render_);

  render_gradient_.alpha = {};
  render_gradient_.albedo = {};
  render_gradient_.depth = {};
  raster::LossOptions loss_options{.ssim_weight = options_.ssim_weight,
                                   .encode_srgb = options_.layout.appearance == Appearance::Transfer,
                                   .threads = options_.threads};
  float loss = image_loss(render_.color, view.color.data(), loss_options, render_gradient_.color);
  scale_image(render_gradient_.color, scale);
  if (with_albedo) {
    loss +=
        options_.albedo_weight * image_loss(render_.albedo, view.albedo.data(), loss_options, render_gradient_.albedo);
    scale_image(render_gradient_.albedo, scale * options_.albedo_weight);
  }
  if (with_depth) loss += depth_loss(view, scale);
  return loss * scale;
}

float CpuOptimizer::depth_loss(const TrainingView& view, float scale) {
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
    if (!(expected > 0) || std::isinf(expected)) continue;
    const float difference = render_.depth.data[i] - render_.alpha.data[i] * expected;
    loss += std::abs(difference) * weight;
    const float slope = std::copysign(weight * scale, difference);
    render_gradient_.depth.data[i] = slope;
    render_gradient_.alpha.data[i] = -slope * expected;
  }
  return static_cast<float>(loss);
}

void CpuOptimizer::clamp_albedo() const {
  const ModelPlanes& planes = store_.planes();
  for (int c = ParameterLayout::kAlbedo; c < ParameterLayout::kResidual; ++c) {
    float* const plane = planes.parameters + static_cast<std::size_t>(c) * planes.capacity;
    for (std::size_t i = 0; i < store_.count(); ++i) plane[i] = std::clamp(plane[i], 0.0F, 1.0F);
  }
}

void CpuOptimizer::maintain_density() {
  const std::uint64_t step = store_.step();
  if (options_.densify.enabled) {
    densifier_.observe(gradient_);
    if (step % options_.densify.interval_steps == 0) {
      change([&] { densifier_.densify(store_, options_.densify); });
    }
  }
  if (options_.prune.enabled && step % options_.prune.interval_steps == 0) {
    const Pruning pruning = find_prunable(store_.view(), options_.prune, active_channels_, created_step_, step);
    // A change of structure costs every reader: not for a handful that nobody sees anyway.
    if (pruning.not_finite || pruning.removed * 500 >= store_.count()) remove(pruning.mask);
    if (pruning.not_finite) spdlog::warn("optimizer: Gaussians that were not finite were removed at step {}", step);
  }
}

void CpuOptimizer::remove(const std::vector<std::uint8_t>& prune_mask) {
  std::vector<std::uint32_t> keep;
  store_.change([&] {
    const ColumnMoves moves = store_.remove(prune_mask.data());
    adam_.move({moves.from, moves.moved}, {moves.to, moves.moved});
    keep = kept_columns(moves);
  });
  adam_.resize(store_.layout(), store_.count());
  densifier_.permute(keep);
  std::vector<std::uint64_t> created_step(keep.size());
  for (std::size_t i = 0; i < keep.size(); ++i) created_step[i] = created_step_[keep[i]];
  created_step_ = std::move(created_step);
}

}  // namespace splatbus::trainer
