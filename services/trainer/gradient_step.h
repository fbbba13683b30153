#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "device/stream.h"
#include "model/page_store.h"
#include "raster/adam.h"
#include "raster/rasterizer.h"
#include "trainer/gaussian_kernels.h"
#include "trainer/options.h"
#include "trainer/view_store.h"

namespace splatbus::trainer {

/// What a step saw in one of its views.
struct ViewLook {
  TrainingViewPtr view;
  float loss = 0;
  std::vector<raster::PageLook> pages;  ///< L1 error in display space
  std::optional<float> active_share;    ///< of what shows (PageLook::pairs), where pages train; none: not looked at
};

/// Of pages that a view shows.
[[nodiscard]] float active_share(std::span<const raster::PageLook> pages, const model::PageTable& table);

/// Steps that came to their end since the last report.
struct StepReport {
  std::size_t steps = 0, views = 0;
  double seconds = 0;           ///< of optimizer time
  double loss = 0;              ///< mean over the views
  double masked_share = 0;      ///< of their pixels, where nothing models yet what they show; mean over the views
  std::vector<ViewLook> looks;  ///< of the steps' views

  StepReport& operator+=(const StepReport& later);
};

/// A row a light of a scene, by index, on the model's device.
struct SceneVisibility {
  std::shared_ptr<const std::uint8_t> values;
  std::size_t stride = 0;  ///< from one row to the next
  std::uint32_t rows = 1;
};

/// A view and what its own scene's lights see; null: the model's own, of the sun.
struct PairedView {
  TrainingViewPtr view;
  SceneVisibility visibility;
};

/// Render, loss, backward pass and Adam on the parameters of a PageStore, in place: what each device does in a way of
/// its own. Belongs to one thread.
class GradientStep {
 public:
  virtual ~GradientStep() = default;
  GradientStep(const GradientStep&) = delete;
  GradientStep& operator=(const GradientStep&) = delete;

  /// Chooses the batch and the half life of the rates where they are left open.
  virtual void set_options(Options& options) = 0;
  /// Of a mini-batch whose pictures lie in the store's memory. Bounds of the store's view() hold afterwards on the
  /// device; on CUDA the step is only enqueued, and PageStore::refresh_bounds() makes those on the host hold.
  virtual void step(std::span<const PairedView> views) = 0;
  /// Steps that are done since the last call; with `wait`, all there are, after waiting for them.
  virtual StepReport finished(bool wait) = 0;

  /// The store's structure has changed, or pages have frozen: `fresh` begin anew, then what was kept of moves.from[k]
  /// is that of moves.to[k].
  virtual void follow(std::span<const IndexRange> fresh, const model::Moves& moves) = 0;
  /// What is kept of a page's moments, to go on elsewhere, on either device: host memory of raster::moment_floats().
  /// Copies are done when stream() is.
  [[nodiscard]] virtual raster::PageMoments moments_of(std::uint32_t page) const = 0;
  virtual void save_moments(std::uint32_t page, float* moments) const = 0;
  virtual void restore_moments(std::uint32_t page, raster::PageMoments kind, const float* moments) = 0;

  /// Of the steps since clear_statistics(), gathered with Options::densify; null where they are not.
  [[nodiscard]] virtual kernels::ScreenStatistics statistics() const = 0;
  virtual void clear_statistics() = 0;
  /// Behind which more work on the parameters is enqueued.
  [[nodiscard]] virtual device::StreamView stream() const = 0;

 protected:
  GradientStep() = default;
};

using StepMaker = std::function<std::unique_ptr<GradientStep>(model::PageStore&, const Options&)>;

/// The one for the store's device. Throws bus::Error or std::runtime_error when it cannot be had.
[[nodiscard]] std::unique_ptr<GradientStep> make_gradient_step(model::PageStore& store, const Options& options);
[[nodiscard]] std::unique_ptr<GradientStep> make_cpu_step(model::PageStore& store, const Options& options);
/// raster::cuda::TrainStep: nothing but small figures leaves the device.
[[nodiscard]] std::unique_ptr<GradientStep> make_cuda_step(model::PageStore& store, const Options& options);

}  // namespace splatbus::trainer
