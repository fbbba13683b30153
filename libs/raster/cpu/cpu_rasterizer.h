#pragma once

#include "raster/cpu/bin.h"
#include "raster/cpu/frame.h"
#include "raster/cpu/kernels.h"
#include "raster/cpu/sort.h"
#include "raster/cpu/workers.h"
#include "raster/rasterizer.h"

namespace splatbus::raster::cpu {

class CpuRasterizer : public Rasterizer {
 public:
  explicit CpuRasterizer(int threads) : workers_(threads) {}

  void forward(const GaussiansView& gaussians, const Camera& camera, const SceneState& scene,
               const RenderOptions& options, Render& out) override;
  void backward(const RenderGradient& gradient, ParameterGradient& out) override;
  void backward_step(const RenderGradient& gradient, const std::vector<float>& learning_rate, Adam& adam,
                     float* parameters, ParameterGradient& statistics) override;
  void render(const GaussiansView& gaussians, const Camera& camera, const SceneState& scene,
              const RenderOptions& options, Render& out) override;
  void look_at_pages(const Image& error, std::vector<PageLook>& looks) override;
  void opacity_within(float distance_m, std::vector<float>& opacity) override;
  [[nodiscard]] std::vector<StageTime> stage_times() const override;

 private:
  void run_forward(const GaussiansView& gaussians, const Camera& camera, const SceneState& scene,
                   const RenderOptions& options, bool keep, Render& out);
  /// Cuts the Gaussians of pages that may show into Frame::pieces.
  void list_pieces(const SceneState& scene);
  void project();
  [[nodiscard]] GradientTarget target_of(ParameterGradient& out) const;
  void blend_backward(const RenderGradient& gradient);

  Workers workers_;
  Frame frame_;
  Scratch<DepthKey> spare_keys_;
  std::vector<PageLook> page_sums_;
  std::vector<IndexRange> shown_ranges_, adam_pieces_;
  std::vector<std::size_t> room_of_piece_, visible_of_piece_, first_of_piece_;
  DepthSorter sorter_;
  TileBinner binner_;
  std::vector<StageTime> forward_times_, backward_times_;
};

}  // namespace splatbus::raster::cpu
