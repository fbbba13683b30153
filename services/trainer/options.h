#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "bus/parameters.h"
#include "gaussians/model.h"

namespace splatbus::trainer {

/// Adam's step sizes, each in the unit of its channel.
struct LearningRates {
  float mean_extents = 0;  ///< metres per metre of scene extent
  float log_scale = 0, rotation = 0, opacity_logit = 0;
  float albedo = 0, residual = 0;
  float sh_dc = 0;  ///< Radiance; the higher bands take a twentieth of it (Kerbl et al. 2023)
};

struct PruneOptions {
  bool enabled = true;
  std::uint64_t interval_steps = 0;
  std::uint64_t min_age_steps = 0;  ///< of a Gaussian
  float min_opacity = 0;
  float max_scale_m = 0;  ///< largest standard deviation
};

struct DensifyOptions {
  bool enabled = false;
  std::uint64_t interval_steps = 0;
  float gradient_threshold = 0;  ///< of the mean |dL/d(projected mean)|, NDC
  float clone_max_scale_m = 0;   ///< larger ones are split
};

/// The trainer's parameters as numbers.
struct Options {
  // Fixed once started.
  ParameterLayout layout;
  std::size_t capacity = 0;            ///< Gaussians that the first slab has room for
  std::size_t max_gaussians = 0;       ///< beyond it nothing is inserted
  std::size_t max_picture_pixels = 0;  ///< larger pictures are refused
  std::uint64_t seed = 0;
  int threads = 0;  ///< 0: all cores

  // Changed at run time.
  bool paused = false;
  std::uint64_t run_until = 0;  ///< step at which to stop, 0: none
  int batch = 0;                ///< views a step, 0: as suits the optimizer
  int input_view_interval = 0;  ///< one input view after that many reference views, 0: none
  bool antialias = true;
  bool residual = true;  ///< Transfer: the residual transfer trains
  float ssim_weight = 0, albedo_weight = 0, depth_weight = 0;
  float average_decay = 0;                    ///< a step
  float average_s = 0;                        ///< of optimizer time that the average covers at least
  float half_rate_steps = 0, least_rate = 0;  ///< as in raster::Adam
  float scene_extent_m = 0;
  LearningRates learning_rates;
  PruneOptions prune;
  DensifyOptions densify;
};

[[nodiscard]] std::vector<bus::ParameterSpec> parameter_specs();
[[nodiscard]] Options read_options(const bus::Parameters& parameters);

/// Channels that train; those above are constants of the model.
[[nodiscard]] int active_channels(const Options& options);

/// One rate a channel of `options.layout`, for raster::Adam.
[[nodiscard]] std::vector<float> channel_learning_rates(const Options& options);

}  // namespace splatbus::trainer
