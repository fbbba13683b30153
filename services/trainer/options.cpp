#include "trainer/options.h"

#include <algorithm>
#include <string>

namespace splatbus::trainer {

namespace {

constexpr bool kFixed = false;

std::vector<bus::ParameterSpec> fixed_specs() {
  return {
      {.name = "appearance",
       .default_value = std::string("transfer"),
       .description = "appearance model",
       .choices = {"transfer", "radiance"},
       .runtime = kFixed},
      {.name = "sh_degree",
       .default_value = std::int64_t{3},
       .description = "degree of the spherical harmonics, radiance only",
       .minimum = 0,
       .maximum = 3,
       .runtime = kFixed},
      {.name = "capacity",
       .default_value = std::int64_t{400000},
       .description = "Gaussians that the model's memory has room for before it is moved to one twice as large",
       .minimum = 16,
       .maximum = 1 << 24,
       .runtime = kFixed},
      {.name = "max_gaussians",
       .default_value = std::int64_t{2000000},
       .description = "Gaussians beyond which nothing is inserted",
       .minimum = 1,
       .maximum = 1 << 24,
       .runtime = kFixed},
      {.name = "max_picture_mpixels",
       .default_value = 16.0,
       .description = "2^20 pixels of the largest picture that is trained; larger ones are refused",
       .minimum = 0.001,
       .maximum = 64,
       .runtime = kFixed},
      {.name = "seed",
       .default_value = std::int64_t{1},
       .description = "of the order of views",
       .minimum = 0,
       .maximum = 1e15,
       .runtime = kFixed},
      {.name = "threads",
       .default_value = std::int64_t{0},
       .description = "of the rasterizer, 0: one a core",
       .minimum = 0,
       .maximum = 256,
       .runtime = kFixed},
  };
}

bus::ParameterSpec number(const char* name, double value, const char* description, double minimum, double maximum) {
  return {.name = name, .default_value = value, .description = description, .minimum = minimum, .maximum = maximum};
}

bus::ParameterSpec integer(const char* name, std::int64_t value, const char* description, double maximum) {
  return {.name = name, .default_value = value, .description = description, .minimum = 0, .maximum = maximum};
}

bus::ParameterSpec flag(const char* name, bool value, const char* description) {
  return {.name = name, .default_value = value, .description = description};
}

}  // namespace

std::vector<bus::ParameterSpec> parameter_specs() {
  auto specs = fixed_specs();
  const std::vector<bus::ParameterSpec> runtime = {
      flag("paused", false, "no optimizer steps while true"),
      integer("run_until", 0, "step at which the optimizer stops, 0: never", 1e15),
      integer("batch", 0, "views an optimizer step, 0: one on the CPU, two on a GPU", 256),
      integer("input_view_interval", 3, "one input picture is trained after that many reference views, 0: none", 1e6),
      flag("antialias", true, "opacity compensation for the pixel filter"),
      flag("residual", true, "transfer: train the residual beside albedo and normal"),
      number("ssim_weight", 0.2, "of 1 - SSIM in the loss, the rest is L1", 0, 1),
      number("albedo_weight", 0.3, "of the albedo picture's loss against the lit picture's, 0: not used", 0, 100),
      number("depth_weight", 0.0, "of the depth loss, per scene extent, 0: not used", 0, 100),
      number("average_decay", 0.98, "of the parameters' average over time, a step", 0, 0.9999),
      number("average_s", 0.5, "of optimizer time that the average covers at least, s", 0, 60),
      number("scene_extent_m", 5.0, "size of the content in metres, the unit of the mean's learning rate", 1e-3, 1e6),
      number("half_rate_steps", -1,
             "a Gaussian's own steps after which its learning rates are halved; 0: constant, "
             "-1: 1000 on the CPU, 200 on a GPU",
             -1, 1e9),
      number("least_rate", 0.01, "what a Gaussian's learning rates keep at least, of themselves", 0, 1),
      number("lr_mean", 0.8e-4, "learning rate of means, in scene extents", 0, 1),
      number("lr_log_scale", 0.03, "learning rate of log-scales", 0, 1),
      number("lr_rotation", 3e-3, "learning rate of quaternions", 0, 1),
      number("lr_opacity", 2.5e-2, "learning rate of opacity logits", 0, 1),
      number("lr_albedo", 5e-3, "learning rate of linear albedo", 0, 1),
      number("lr_residual", 5e-4, "learning rate of residual transfer coefficients", 0, 1),
      number("lr_sh_dc", 2.5e-3, "radiance: learning rate of the constant band, a twentieth for the others", 0, 1),
      flag("prune", true, "remove Gaussians that are transparent, huge or not finite"),
      integer("prune_interval", 100, "steps between prunings", 1e9),
      integer("prune_min_age", 100, "steps for which a new Gaussian is spared", 1e9),
      number("prune_opacity", 0.005, "opacity below which a Gaussian goes", 0, 1),
      number("prune_scale", 0.5, "largest standard deviation that may stay, in scene extents", 1e-6, 1e6),
      flag("densify", false, "clone and split where the projected means' gradient is large"),
      integer("densify_interval", 100, "steps between densifications", 1e9),
      number("densify_gradient", 2e-4, "mean gradient of the projected mean, NDC, above which a Gaussian is cloned", 0,
             1),
      number("densify_scale", 0.01, "standard deviation in scene extents above which it is split instead", 0, 1e6),
  };
  specs.insert(specs.end(), runtime.begin(), runtime.end());
  return specs;
}

Options read_options(const bus::Parameters& parameters) {
  const auto real = [&](const char* name) { return static_cast<float>(parameters.number(name)); };
  const auto count = [&](const char* name) { return static_cast<std::uint64_t>(parameters.integer(name)); };

  Options options;
  options.layout.appearance = parameters.text("appearance") == "radiance" ? Appearance::Radiance : Appearance::Transfer;
  options.layout.sh_degree = static_cast<int>(parameters.integer("sh_degree"));
  options.capacity = count("capacity");
  options.max_gaussians = count("max_gaussians");
  options.max_picture_pixels = static_cast<std::size_t>(parameters.number("max_picture_mpixels") * (1 << 20));
  options.seed = count("seed");
  options.threads = static_cast<int>(parameters.integer("threads"));

  options.paused = parameters.boolean("paused");
  options.run_until = count("run_until");
  options.batch = static_cast<int>(parameters.integer("batch"));
  options.input_view_interval = static_cast<int>(parameters.integer("input_view_interval"));
  options.antialias = parameters.boolean("antialias");
  options.residual = parameters.boolean("residual");
  options.ssim_weight = real("ssim_weight");
  options.albedo_weight = options.layout.appearance == Appearance::Transfer ? real("albedo_weight") : 0.0F;
  options.depth_weight = real("depth_weight");
  options.average_decay = real("average_decay");
  options.average_s = real("average_s");
  options.half_rate_steps = real("half_rate_steps");
  options.least_rate = real("least_rate");
  options.scene_extent_m = real("scene_extent_m");
  options.learning_rates = {.mean_extents = real("lr_mean"),
                            .log_scale = real("lr_log_scale"),
                            .rotation = real("lr_rotation"),
                            .opacity_logit = real("lr_opacity"),
                            .albedo = real("lr_albedo"),
                            .residual = real("lr_residual"),
                            .sh_dc = real("lr_sh_dc")};
  options.prune = {.enabled = parameters.boolean("prune"),
                   .interval_steps = std::max<std::uint64_t>(1, count("prune_interval")),
                   .min_age_steps = count("prune_min_age"),
                   .min_opacity = real("prune_opacity"),
                   .max_scale_m = real("prune_scale") * options.scene_extent_m};
  options.densify = {.enabled = parameters.boolean("densify"),
                     .interval_steps = std::max<std::uint64_t>(1, count("densify_interval")),
                     .gradient_threshold = real("densify_gradient"),
                     .clone_max_scale_m = real("densify_scale") * options.scene_extent_m};
  return options;
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
