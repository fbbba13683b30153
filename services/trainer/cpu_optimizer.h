#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "raster/adam.h"
#include "raster/rasterizer.h"
#include "trainer/average.h"
#include "trainer/density.h"
#include "trainer/optimizer.h"

namespace splatbus::trainer {

/// Trains a model in host memory. Every step is done when step() returns.
class CpuOptimizer final : public Optimizer {
 public:
  CpuOptimizer(ModelStore& store, const Options& options);

  void set_options(const Options& options) override;
  StepReport step(std::span<const TrainingViewPtr> views) override;
  StepReport finish() override { return {}; }

 private:
  void before_change() override {}
  void follow_growth() override;
  void set_visibility(const VisibilityCommand& relit) override;
  /// Renders the view; the loss and, in render_gradient_, its gradient, both times `scale`.
  double render_loss(const TrainingView& view, float scale);
  float depth_loss(const TrainingView& view, float scale);
  void clamp_albedo() const;
  void maintain_density();
  void remove(const std::vector<std::uint8_t>& prune_mask);

  int active_channels_ = 0;
  std::vector<float> learning_rates_;
  std::unique_ptr<raster::Rasterizer> rasterizer_;
  raster::Adam adam_;
  raster::ParameterGradient gradient_;
  raster::Render render_;
  raster::RenderGradient render_gradient_;
  TimeAverage average_;
  Densifier densifier_;
  std::vector<std::uint64_t> created_step_;  ///< step at which each column was inserted
};

}  // namespace splatbus::trainer
