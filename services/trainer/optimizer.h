#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "raster/adam.h"
#include "raster/rasterizer.h"
#include "trainer/average.h"
#include "trainer/cell_stats.h"
#include "trainer/commands.h"
#include "trainer/density.h"
#include "trainer/model_store.h"
#include "trainer/options.h"
#include "trainer/view_store.h"

namespace splatbus::trainer {

/// Trains the model of a ModelStore: applies what others ask of it between steps, and steps. Belongs to one thread.
/// What it keeps of its own for each Gaussian (Adam's moments, age) begins anew with a new Optimizer.
class Optimizer {
 public:
  Optimizer(ModelStore& store, const Options& options);

  void set_options(const Options& options);
  [[nodiscard]] const Options& options() const { return options_; }

  /// One change of structure for all of them; visibility is taken over in place. Returns whether the structure changed.
  bool apply(const Commands& commands);

  /// Render, loss, backward pass and Adam on a mini-batch, then the average over time, and pruning when it is due.
  /// Returns the mean loss: (1 - lambda) L1 + lambda (1 - SSIM) of the lit picture, plus the weighted terms of albedo
  /// and depth. The structure may have changed. Nothing happens to an empty model or batch.
  double step(std::span<const TrainingViewPtr> views);

  [[nodiscard]] const CellStats& cells() const { return cells_; }

 private:
  /// Renders the view; the loss and, in render_gradient_, its gradient, both times `scale`.
  double render_loss(const TrainingView& view, float scale);
  float depth_loss(const TrainingView& view, float scale);
  void clamp_albedo() const;
  void maintain_density();
  void remove(const std::vector<std::uint8_t>& dead);
  /// A change of structure that adds or freezes. What is kept here for each Gaussian follows the model even when it
  /// throws: it may have moved to a larger slab before.
  void change(const std::function<void()>& work);
  void follow_growth();

  ModelStore& store_;
  Options options_;
  int active_channels_ = 0;
  std::vector<float> learning_rates_;
  std::unique_ptr<raster::Rasterizer> rasterizer_;
  raster::Adam adam_;
  raster::ParameterGradient gradient_;
  raster::Render render_;
  raster::RenderGradient render_gradient_;
  TimeAverage average_;
  CellStats cells_;
  Densifier densifier_;
  std::vector<std::uint64_t> birth_;  ///< step at which each column was inserted
};

}  // namespace splatbus::trainer
