#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "trainer/cell_stats.h"
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

/// A view that was left out of a step, for there is no memory for a step of such pictures.
struct LeftOut {
  TrainingViewPtr view;
  std::string why;
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

  /// One change of structure for all of them; visibility is taken over in place. Inserts that there is no memory for
  /// are refused, and the model stays as it is. Returns whether the structure changed.
  bool apply(const Commands& commands);
  [[nodiscard]] std::uint64_t refused_inserts() const { return refused_inserts_; }

  /// Render, loss, backward pass and Adam on a mini-batch, then the average over time, and pruning when it is due. The
  /// loss is (1 - lambda) L1 + lambda (1 - SSIM) of the lit picture, plus the weighted terms of albedo and depth. The
  /// structure may have changed. Nothing happens to an empty model or batch. The views' pictures lie in the model's
  /// kind of memory.
  virtual StepReport step(std::span<const TrainingViewPtr> views) = 0;

  /// Waits for all that is under way; the structure may have changed.
  virtual StepReport finish() = 0;

  /// The views of the steps since the last call that were left out. Others of the same steps were trained.
  [[nodiscard]] virtual std::vector<LeftOut> take_left_out() { return {}; }

  [[nodiscard]] const CellTable& cells() const { return cells_; }

 protected:
  explicit Optimizer(ModelStore& store) : store_(store) {}

  /// A change of structure that adds or freezes. What is kept here for each Gaussian follows the model even when it
  /// throws: it may have moved to a larger slab before.
  void change(const std::function<void()>& work);
  /// Of the average over time, a step: options().ema_decay, or as much more as ema_s of optimizer time takes at
  /// the pace of the steps so far.
  [[nodiscard]] float average_decay() const;
  /// Ends what is under way, so that nothing of this optimizer's own works on the planes; the structure may change.
  virtual void before_change() = 0;
  /// Columns were added or frozen, and perhaps moved to other planes.
  virtual void follow_growth() = 0;
  /// Why there is no memory for a model of that capacity; empty when there is, or when that cannot be said before.
  [[nodiscard]] virtual std::string lacks_memory_for(std::size_t /*capacity*/) const { return {}; }

  ModelStore& store_;
  Options options_;
  CellTable cells_;

 private:
  /// Those that the model does not hold yet, and that there is memory for.
  [[nodiscard]] std::vector<const InsertBatch*> admitted(const std::vector<InsertBatch>& inserts);

  std::uint64_t refused_inserts_ = 0;
  bool warned_insert_ = false;
};

/// The one for the memory in which the model lies. Throws bus::Error or std::runtime_error when it cannot be had.
[[nodiscard]] std::unique_ptr<Optimizer> make_optimizer(ModelStore& store, const Options& options);

}  // namespace splatbus::trainer
