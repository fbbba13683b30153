#include "trainer/options.h"

#include <algorithm>

#include "trainer/carving.h"

namespace splatbus::trainer {

void Options::bind(bus::ParameterBinder& p) {
  using bus::kFixed;
  using bus::kMebibytes;
  constexpr double kMaxSteps = 1e15;
  constexpr double kMebipixels = 1 << 20;
  p.add("appearance", layout.appearance, "appearance model",
        {{"transfer", Appearance::Transfer}, {"radiance", Appearance::Radiance}}, kFixed);
  p.add("sh_degree", layout.sh_degree, "degree of the spherical harmonics, radiance only", {0, 3}, kFixed);
  p.add("max_gaussians", max_gaussians, "Gaussians beyond which nothing is inserted",
        {1, static_cast<double>(kGaussianLimit)}, kFixed);
  p.add("max_picture_mpixels", max_picture_pixels, "2^20 pixels of the largest picture that is trained", {1, 64},
        kFixed, kMebipixels);
  p.add("seed", seed, "of the order of views", {0, kMaxSteps}, kFixed);
  p.add("threads", threads, "of the rasterizer, 0: one a core", {0, 256}, kFixed);
  p.add("world", world.folder, "folder that keeps the model across runs, empty: none", kFixed);
  p.add("world_period_s", world.period_s, "s from one commit to the folder to the next", {0.01, 60}, kFixed);
  p.add("world_mb_s", world.bytes_per_s, "MiB a second of pages that are kept because their values have changed",
        {1, 4096}, kFixed, kMebibytes);
  p.add("world_staging_mb", world.staging_bytes, "MiB of memory for pages on their way to the folder", {1, 4096},
        kFixed, kMebibytes);
  constexpr double kMebibyteLimit = 1 << 24;
  p.add(
      "device_mb", world.device_bytes,
      "MiB of a GPU's memory for the model and what is kept beside it, beyond which far pages go to disk, 0: no bound",
      {0, kMebibyteLimit}, kFixed, kMebibytes);
  p.add("host_mb", world.host_bytes, "the same of host memory, where that is where the model is", {0, kMebibyteLimit},
        kFixed, kMebibytes);
  p.add("disk_mb", world.disk_bytes,
        "MiB of pages in the world folder, beyond which the farthest are forgotten, 0: no bound", {0, kMebibyteLimit},
        kFixed, kMebibytes);
  p.add("fetch_m", world.fetch_m, "distance from a viewer within which pages come back from disk, m", {0, 1e6}, kFixed);

  p.add("paused", paused, "no optimizer steps while true");
  p.add("run_until", run_until, "step at which the optimizer stops, 0: never", {0, kMaxSteps});
  p.add("batch", batch, "views an optimizer step, 0: one on the CPU, two on a GPU", {0, 256});
  p.add("input_view_interval", input_view_interval,
        "one input picture is trained after that many reference views, 0: none", {0, 1e6});
  p.add("views_by_loss", views_by_loss, "views of less loss than others are left out now and then; on the CPU");
  p.add(
      "pair_visibility", pair_visibility,
      "transfer: a view trains with the visibility of its own scene version, or waits for it; false: with the newest");
  p.add("antialias", antialias, "opacity compensation for the pixel filter");
  p.add("residual", residual, "transfer: train the residual beside albedo and normal");
  p.add("ssim_weight", ssim_weight, "of 1 - SSIM in the loss, the rest is L1", {0, 1});
  p.add("albedo_weight", albedo_weight, "of the albedo picture's loss against the lit picture's, 0: not used",
        {0, 100});
  p.add("depth_weight", depth_weight, "of the depth loss, per scene extent, 0: not used", {0, 100});
  p.add("mask_opacity", mask_opacity,
        "where the engine shows a surface and all around the model's opacity is below this, nothing is learned; 0: "
        "everywhere something is",
        {0, 1});
  p.add("ema_decay", ema_decay, "of the parameters' average over time, a step", {0, 0.9999});
  p.add("ema_s", ema_s, "of optimizer time that the average covers at least, s", {0, 60});
  p.add("scene_extent_m", scene_extent_m, "size of the content in metres, the unit of the mean's learning rate",
        {1e-3, 1e6});
  p.add("lr_half_life_steps", lr_half_life_steps,
        "a Gaussian's own steps after which its learning rates are halved; 0: constant, -1: 1000 on the CPU, 200 on a "
        "GPU",
        {-1, 1e9});
  p.add("lr_min_factor", lr_min_factor, "what a Gaussian's learning rates keep at least, of themselves", {0, 1});
  p.add("lr_recovery", lr_recovery, "learning rates rise again where the loss of a view does");
  p.add("lr_mean", learning_rates.mean_extents, "learning rate of means, in scene extents", {0, 1});
  p.add("lr_log_scale", learning_rates.log_scale, "learning rate of log-scales", {0, 1});
  p.add("lr_rotation", learning_rates.rotation, "learning rate of quaternions", {0, 1});
  p.add("lr_opacity", learning_rates.opacity_logit, "learning rate of opacity logits", {0, 1});
  p.add("lr_albedo", learning_rates.albedo, "learning rate of linear albedo", {0, 1});
  p.add("lr_residual", learning_rates.residual, "learning rate of residual transfer coefficients", {0, 1});
  p.add("lr_sh_dc", learning_rates.sh_dc, "radiance: learning rate of the constant band, a twentieth for the others",
        {0, 1});
  p.add("prune", prune.enabled, "remove Gaussians that are transparent, huge or not finite");
  p.add("prune_interval", prune.interval_steps, "steps between prunings", {1, 1e9});
  p.add("prune_min_age", prune.min_age_steps, "steps for which a new Gaussian is spared", {0, 1e9});
  p.add("prune_opacity", prune.min_opacity, "opacity below which a Gaussian goes", {0, 1});
  p.add("prune_scale", prune_scale_extents, "largest standard deviation that may stay, in scene extents", {1e-6, 1e6});
  p.add("carve", carve.enabled, "remove Gaussians where pictures with depth show free space");
  p.add("carve_votes", carve.votes, "engine frames that have to show the space free, with none between that does not",
        {1, kernels::kMaxCarveVotes});
  p.add("freeze", freeze.enabled, "pages whose loss and movement have settled rest");
  p.add("freeze_after_s", freeze.after_s, "optimizer time over which a page's loss must not have fallen, s", {0, 3600});
  p.add("freeze_gain", freeze.least_gain, "part of its loss that a page must lose in that time to train on", {0, 1});
  p.add("freeze_movement", freeze.most_movement,
        "how far a page's Gaussians may be from their averages when it freezes, as a part of themselves", {0, 10});
  p.add("thaw_rise", freeze.thaw_rise, "of a frozen page's loss, above which it trains again", {1, 100});
  p.add("densify", densify.enabled, "clone and split where the projected means' gradient is large");
  p.add("densify_interval", densify.interval_steps, "steps between densifications", {1, 1e9});
  p.add("densify_gradient", densify.gradient_threshold,
        "mean gradient of the projected mean, NDC, above which a Gaussian is cloned", {0, 1});
  p.add("densify_scale", densify_scale_extents, "standard deviation in scene extents above which it is split instead",
        {0, 1e6});

  if (layout.appearance == Appearance::Radiance) albedo_weight = 0;
  prune.max_scale_m = prune_scale_extents * scene_extent_m;
  densify.clone_max_scale_m = densify_scale_extents * scene_extent_m;
}

bool wants_depth(const Options& options) {
  return options.depth_weight > 0 || options.carve.enabled;
}

int active_channels(const Options& options) {
  const bool without_residual = options.layout.appearance == Appearance::Transfer && !options.residual;
  return without_residual ? ParameterLayout::kResidual : options.layout.channels();
}

std::vector<float> channel_learning_rates(const Options& options) {
  const LearningRates& rates = options.learning_rates;
  std::vector<float> of_channel(static_cast<std::size_t>(options.layout.channels()), 0.0F);
  const auto set = [&](int first, int end, float rate) {
    std::fill(of_channel.begin() + first, of_channel.begin() + end, rate);
  };
  set(ParameterLayout::kMean, ParameterLayout::kLogScale, rates.mean_extents * options.scene_extent_m);
  set(ParameterLayout::kLogScale, ParameterLayout::kRotation, rates.log_scale);
  set(ParameterLayout::kRotation, ParameterLayout::kOpacityLogit, rates.rotation);
  set(ParameterLayout::kOpacityLogit, ParameterLayout::kAppearance, rates.opacity_logit);
  if (options.layout.appearance == Appearance::Transfer) {
    set(ParameterLayout::kAlbedo, ParameterLayout::kResidual, rates.albedo);
    set(ParameterLayout::kResidual, options.layout.channels(), rates.residual);
  } else {
    set(ParameterLayout::kAppearance, ParameterLayout::kAppearance + 3, rates.sh_dc);
    set(ParameterLayout::kAppearance + 3, options.layout.channels(), rates.sh_dc / 20.0F);
  }
  return of_channel;
}

}  // namespace splatbus::trainer
