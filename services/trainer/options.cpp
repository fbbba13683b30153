#include "trainer/options.h"

#include <algorithm>

#include "trainer/carving.h"

namespace splatbus::trainer {

void Options::bind(bus::ParameterBinder& p) {
  using bus::kFixed;
  using bus::kMebibytes;
  constexpr double kMaxSteps = 1e15;
  constexpr double kMebipixels = 1 << 20;
  p.add("appearance", layout.appearance, "appearance model of the Gaussians",
        {{"transfer", Appearance::Transfer}, {"radiance", Appearance::Radiance}}, kFixed);
  p.add("sh_degree", layout.sh_degree, "degree of the spherical harmonics; radiance only", {0, 3}, kFixed);
  p.add("max_gaussians", max_gaussians,
        "most Gaussians in memory; with a world folder or ceilings the farthest pages go to disk before, else nothing "
        "is inserted beyond",
        {1, static_cast<double>(kGaussianLimit)}, kFixed);
  p.add("max_picture_mpixels", max_picture_pixels, "largest picture that is trained on, 2^20 pixels", {1, 64}, kFixed,
        kMebipixels);
  p.add("seed", seed, "random seed of the order of views", {0, kMaxSteps}, kFixed);
  p.add("threads", threads, "CPU rasterizer threads (0: one per core)", {0, 256}, kFixed);
  p.add("cull", cull, "leave pages outside of a view's frustum out of its steps; false: to compare with", kFixed);
  p.add("cull_hidden", cull_hidden,
        "leave pages that the surfaces of a view's picture hide out of its steps; false: to compare with", kFixed);
  p.add("world", world.folder, "folder that keeps the model across runs; empty: none", kFixed);
  p.add("world_period_s", world.period_s, "time between commits to the world folder, s", {0.01, 60}, kFixed);
  p.add("world_mb_s", world.bytes_per_s, "most pages with changed values written to the world folder, MiB/s", {1, 4096},
        kFixed, kMebibytes);
  p.add("world_staging_mb", world.staging_bytes, "memory for pages on their way to the world folder, MiB", {1, 4096},
        kFixed, kMebibytes);
  constexpr double kMebibyteLimit = 1 << 24;
  p.add("device_mb", world.device_bytes,
        "GPU memory for the model and its training state; pages beyond go to disk, farthest first, MiB; 0: no limit",
        {0, kMebibyteLimit}, kFixed, kMebibytes);
  p.add("host_mb", world.host_bytes, "host memory for the same when the model is there, MiB; 0: no limit",
        {0, kMebibyteLimit}, kFixed, kMebibytes);
  p.add("disk_mb", world.disk_bytes,
        "most pages in the world folder; the farthest are forgotten beyond, MiB; 0: no limit", {0, kMebibyteLimit},
        kFixed, kMebibytes);
  p.add("fetch_m", world.fetch_m, "distance from a viewer within which pages come back from disk, m", {0, 1e6}, kFixed);

  p.add("paused", paused, "take no optimizer steps");
  p.add("run_until", run_until, "step at which the optimizer stops; 0: never", {0, kMaxSteps});
  p.add("batch", batch, "views per optimizer step (0: one on the CPU, two on a GPU)", {0, 256});
  p.add("input_view_interval", input_view_interval,
        "reference views between two input pictures that are trained on; 0: train on none", {0, 1e6});
  p.add("kept_view_interval", kept_view_interval,
        "reference views between two pictures of where their cameras stood before, which are kept while the scene "
        "stands still; 0: none are kept",
        {0, 1e6});
  p.add("views_by_loss", views_by_loss, "skip views of low loss now and then; CPU only");
  p.add("pair_visibility", pair_visibility,
        "train a view only with the visibility of its own scene version; false: with the newest; transfer only");
  p.add("antialias", antialias, "compensate opacity for the pixel filter");
  p.add("residual", residual, "train the residual beside albedo and normal; transfer only");
  p.add("ssim_weight", ssim_weight, "weight of 1 - SSIM in the loss; the rest is L1", {0, 1});
  p.add("albedo_weight", albedo_weight, "weight of the albedo picture's loss against the lit picture's; 0: off",
        {0, 100});
  p.add("depth_weight", depth_weight, "weight of the depth loss, per scene extent; 0: off", {0, 100});
  p.add("mask_opacity", mask_opacity,
        "opacity below which nothing is learned where the engine shows a surface; 0: learn everywhere", {0, 1});
  p.add("ema_decay", ema_decay, "decay per step of the parameters' moving average", {0, 0.9999});
  p.add("ema_s", ema_s, "least optimizer time that the moving average covers, s", {0, 60});
  p.add("scene_extent_m", scene_extent_m, "size of the content, the unit of the means' learning rate, m", {1e-3, 1e6});
  p.add("lr_half_life_steps", lr_half_life_steps,
        "a Gaussian's own steps after which its learning rates halve; 0: never; -1: 1000 on the CPU, 200 on a GPU",
        {-1, 1e9});
  p.add("lr_min_factor", lr_min_factor, "smallest factor that aging leaves of a Gaussian's learning rates", {0, 1});
  p.add("lr_recovery", lr_recovery, "raise learning rates again where the loss of a view rises");
  p.add("lr_mean", learning_rates.mean_extents, "learning rate of means, scene extents", {0, 1});
  p.add("lr_log_scale", learning_rates.log_scale, "learning rate of log-scales", {0, 1});
  p.add("lr_rotation", learning_rates.rotation, "learning rate of quaternions", {0, 1});
  p.add("lr_opacity", learning_rates.opacity_logit, "learning rate of opacity logits", {0, 1});
  p.add("lr_albedo", learning_rates.albedo, "learning rate of linear albedo", {0, 1});
  p.add("lr_residual", learning_rates.residual, "learning rate of residual transfer coefficients", {0, 1});
  p.add("lr_sh_dc", learning_rates.sh_dc,
        "learning rate of the constant band; a twentieth for the others; radiance only", {0, 1});
  p.add("most_size", most_size,
        "largest standard deviation of a Gaussian of the world or the sky, of its distance to any camera that trains; "
        "0: any",
        {0, 100});
  p.add("prune", prune.enabled, "remove Gaussians that are transparent, huge or not finite");
  p.add("prune_interval", prune.interval_steps, "steps between prunings", {1, 1e9});
  p.add("prune_min_age", prune.min_age_steps, "steps for which a new Gaussian is spared from pruning", {0, 1e9});
  p.add("prune_opacity", prune.min_opacity, "opacity below which a Gaussian is removed", {0, 1});
  p.add("prune_scale", prune_scale_extents, "largest standard deviation that a Gaussian may have, scene extents",
        {1e-6, 1e6});
  p.add("carve", carve.enabled, "remove Gaussians where pictures with depth show free space");
  p.add("carve_votes", carve.votes, "engine frames in a row that have to show a Gaussian's place as free space",
        {1, kernels::kMaxCarveVotes});
  p.add("freeze", freeze.enabled, "stop training pages whose loss and movement have settled");
  p.add("freeze_after_s", freeze.after_s, "optimizer time without a falling loss before a page freezes, s", {0, 3600});
  p.add("freeze_gain", freeze.least_gain,
        "share of its loss that a page has to lose in freeze_after_s to keep training", {0, 1});
  p.add("freeze_movement", freeze.most_movement,
        "largest distance of a page's Gaussians from their averages when it freezes, relative to their size", {0, 10});
  p.add("freeze_unseen_s", freeze.unseen_s, "optimizer time without a view from near before a page freezes as it is, s",
        {0, 3600});
  p.add("thaw_rise", freeze.thaw_rise, "factor by which a frozen page's loss has to rise before it trains again",
        {1, 100});
  p.add("densify", densify.enabled, "clone and split Gaussians where the gradient of the projected mean is large");
  p.add("densify_interval", densify.interval_steps, "steps between densifications", {1, 1e9});
  p.add("densify_gradient", densify.gradient_threshold,
        "mean gradient of the projected mean above which a Gaussian is cloned, NDC", {0, 1});
  p.add("densify_scale", densify_scale_extents,
        "standard deviation above which a Gaussian is split instead of cloned, scene extents", {0, 1e6});

  if (layout.appearance == Appearance::Radiance) albedo_weight = 0;
  prune.max_scale_m = prune_scale_extents * scene_extent_m;
  densify.clone_max_scale_m = densify_scale_extents * scene_extent_m;
}

bool wants_depth(const Options& options) {
  return options.depth_weight > 0 || options.mask_opacity > 0 || options.carve.enabled;
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
