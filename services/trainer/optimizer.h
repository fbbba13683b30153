#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "trainer/commands.h"
#include "trainer/model_store.h"
#include "trainer/options.h"
#include "trainer/view_store.h"

namespace splatbus::trainer {

/// Steps that came to their end since the last report.
struct StepReport {
  std::size_t steps = 0, views = 0;
  double seconds = 0;  ///< of optimizer time
  double loss = 0;     ///< mean over the views

  StepReport& operator+=(const StepReport& later);
};

/// Trains the model of a ModelStore: applies what others ask of it between steps, and steps. Belongs to one thread.
/// What it keeps of its own for each Gaussian (Adam's moments, age) begins anew with a new Optimizer.
///
/// In device memory a few steps may still be under way when step() returns. They count in ModelStore::step() already,
/// in its optimizer_s() once they are done.
class Optimizer {
 public:
  virtual ~Optimizer() = default;
  Optimizer(const Optimizer&) = delete;
  Optimizer& operator=(const Optimizer&) = delete;

  virtual void set_options(const Options& options) = 0;
  /// Those that were set, with the batch that this optimizer chooses where they leave it open.
  [[nodiscard]] const Options& options() const { return options_; }

  /// One change of structure for all of them; visibility is taken over in place, behind the steps under way. Returns
  /// whether the structure changed.
  bool apply(const Commands& commands);

  /// Render, loss, backward pass and Adam on a mini-batch, then the average over time, and pruning when it is due. The
  /// loss is (1 - lambda) L1 + lambda (1 - SSIM) of the lit picture, plus the weighted terms of albedo and depth. The
  /// structure may have changed. Nothing happens to an empty model or batch. The views' pictures lie in the model's
  /// kind of memory.
  virtual StepReport step(std::span<const TrainingViewPtr> views) = 0;

  /// Waits for all that is under way; the structure may have changed.
  virtual StepReport finish() = 0;

 protected:
  explicit Optimizer(ModelStore& store) : store_(store) {}

  /// A change of structure that adds; what is kept here for each Gaussian follows.
  void change(const std::function<void()>& work);
  /// Of the average over time, a step: options().ema_decay, or as much more as ema_s of optimizer time takes at
  /// the pace of the steps so far.
  [[nodiscard]] float ema_decay() const;
  /// Ends what is under way, so that nothing of this optimizer's own works on the planes; the structure may change.
  virtual void before_change() = 0;
  /// Columns were added, and perhaps moved to other planes.
  virtual void follow_growth() = 0;
  /// Writes visibility that the store accepts.
  virtual void set_visibility(const VisibilityCommand& relit) = 0;

  ModelStore& store_;
  Options options_;
};

/// The one for the memory in which the model lies. Throws bus::Error or std::runtime_error when it cannot be had.
[[nodiscard]] std::unique_ptr<Optimizer> make_optimizer(ModelStore& store, const Options& options);

}  // namespace splatbus::trainer
