#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "bus/parameters.h"
#include "gaussians/model.h"
#include "wire/model_limits.h"

namespace splatbus::trainer {

/// Adam's step sizes, each in the unit of its channel.
struct LearningRates {
  float mean_extents = 0.8e-4F;  ///< metres per metre of scene extent
  float log_scale = 0.03F, rotation = 3e-3F, opacity_logit = 2.5e-2F;
  float albedo = 5e-3F, residual = 3e-4F;
  float sh_dc = 2.5e-3F;  ///< Radiance; the higher bands take a twentieth of it (Kerbl et al. 2023)
};

struct PruneOptions {
  bool enabled = true;
  std::uint64_t interval_steps = 100;
  std::uint64_t min_age_steps = 100;  ///< of a Gaussian
  float min_opacity = 0.005F;
  float max_scale_m = 0;  ///< largest standard deviation
};

/// Of what the engine's depth shows to be free.
struct CarveOptions {
  bool enabled = true;
  std::uint32_t votes = 2;  ///< of different engine frames
};

/// When a page rests: docs/decisions/0103-freezing.md.
struct FreezeOptions {
  bool enabled = true;
  double after_s = 5;          ///< of optimizer time, twice: the time over which its loss is compared
  float least_gain = 0.05F;    ///< part of its loss that a page which trains on loses in that time
  float most_movement = 0.1F;  ///< as page_movements()
  double unseen_s = 8;         ///< of optimizer time without a view from near, after which it rests as it is
  float thaw_rise = 1.3F;      ///< of its loss as it froze, above which it trains again
};

struct DensifyOptions {
  bool enabled = false;
  std::uint64_t interval_steps = 100;
  float gradient_threshold = 2e-4F;  ///< of the mean |dL/d(projected mean)|, NDC
  float clone_max_scale_m = 0;       ///< larger ones are split
};

/// A world folder (world_keeper.h).
struct WorldParameters {
  std::string folder;                                  ///< empty: none
  double period_s = 1;                                 ///< from commit to commit
  std::size_t bytes_per_s = std::size_t{32} << 20U;    ///< of model that are copied because values have changed
  std::size_t staging_bytes = std::size_t{64} << 20U;  ///< of memory for pages on their way to the folder
  // Ceilings of the model and of what the trainer keeps beside it; 0: none.
  std::size_t device_bytes = 0, host_bytes = 0, disk_bytes = 0;
  std::size_t max_gaussians = 0;  ///< in memory; 0: as many as the other ceilings have room for
  float fetch_m = 40;             ///< pages nearer to a viewer than this are not on disk alone
};

/// The trainer's parameters as numbers.
struct Options {
  // Fixed once started.
  ParameterLayout layout;
  /// In memory; beyond it nothing is inserted, but where there is a world folder or a ceiling of memory the farthest
  /// pages go to disk before.
  std::size_t max_gaussians = kDefaultMaxGaussians;
  std::size_t max_picture_pixels = 1U << 24U;  ///< larger pictures are refused
  std::uint64_t seed = 1;
  int threads = 0;          ///< 0: all cores
  bool cull = true;         ///< pages that a view's frustum does not touch are left out of its passes
  bool cull_hidden = true;  ///< with cull: and those that the surfaces of its picture hide
  WorldParameters world;

  // Changed at run time.
  bool paused = false;
  std::uint64_t run_until = 0;  ///< step at which to stop, 0: none
  int batch = 0;                ///< views a step, 0: as suits the optimizer
  int input_view_interval = 3;  ///< one input view after that many reference views, 0: none
  int kept_view_interval = 1;   ///< one view of where cameras stood before after that many reference views, 0: none
  bool views_by_loss = true;    ///< views that have less to teach than others have fewer turns
  bool pair_visibility = true;  ///< Transfer: a view trains with its own scene version's visibility, or not at all
  bool antialias = true;
  bool residual = true;  ///< Transfer: the residual transfer trains
  float ssim_weight = 0.2F, albedo_weight = 0.3F, depth_weight = 0;
  float mask_opacity = 0.5F;                             ///< as mask_unmodelled(); 0: nothing is masked
  float ema_decay = 0.98F;                               ///< of the parameters' average, a step
  float ema_s = 0.5F;                                    ///< of optimizer time that the average covers at least
  float lr_half_life_steps = -1, lr_min_factor = 0.01F;  ///< as in raster::Adam; below 0: as suits the optimizer
  bool lr_recovery = true;                               ///< rates rise again where the loss of a view does
  float scene_extent_m = 5;
  float most_size =
      0.1F;  ///< standard deviation of a Gaussian, of its distance to a camera that it trains with; 0: any
  float prune_scale_extents = 0.5F, densify_scale_extents = 0.01F;
  LearningRates learning_rates;
  PruneOptions prune;
  CarveOptions carve;
  FreezeOptions freeze;
  DensifyOptions densify;

  void bind(bus::ParameterBinder& parameters);
};

/// Whether the depth of pictures is of use.
[[nodiscard]] bool wants_depth(const Options& options);

/// Channels that train; those above are constants of the model.
[[nodiscard]] int active_channels(const Options& options);

/// One rate a channel of `options.layout`, for raster::Adam.
[[nodiscard]] std::vector<float> channel_learning_rates(const Options& options);

}  // namespace splatbus::trainer
