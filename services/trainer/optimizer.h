#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "bus/publisher.h"
#include "device/buffer.h"
#include "model/page_store.h"
#include "trainer/carving.h"
#include "trainer/commands.h"
#include "trainer/freezing.h"
#include "trainer/gradient_step.h"
#include "trainer/handover.h"
#include "trainer/options.h"
#include "trainer/per_index.h"
#include "trainer/view_store.h"
#include "trainer/visibility_ring.h"

namespace splatbus::trainer {

/// Trains the model of a PageStore: applies what others ask of it between steps, and steps. Belongs to one thread.
/// What it keeps of its own for each Gaussian (Adam's moments, age) begins anew with a new Optimizer, unless that goes
/// on with what this one has saved.
///
/// On CUDA a few steps may still be under way when step() returns. They count in PageStore::step() already, in its
/// optimizer_s() once they are done.
class Optimizer {
 public:
  /// Throws what the maker throws.
  Optimizer(model::PageStore& store, const Options& options, const StepMaker& make_step = make_gradient_step);
  ~Optimizer();
  Optimizer(const Optimizer&) = delete;
  Optimizer& operator=(const Optimizer&) = delete;

  void set_options(const Options& options);
  /// Those that were set, with what the device's step chooses where they leave it open.
  [[nodiscard]] const Options& options() const { return options_; }

  /// Returns whether the structure changed. `needed`: scene versions of the views there are, ascending.
  bool apply(const Commands& commands, std::span<const std::uint64_t> needed = {});

  /// Render, loss, backward pass and Adam on a mini-batch, then the average over time, and pruning and densification
  /// when they are due. The loss is (1 - lambda) L1 + lambda (1 - SSIM) of the lit picture, plus the weighted terms of
  /// albedo and depth. The structure may have changed. Nothing happens to an empty model or batch. The views' pictures
  /// lie on the store's device. A view is lit by the visibility of its own scene version where that is here.
  StepReport step(std::span<const TrainingViewPtr> views);
  /// Scene versions whose visibility is here, ascending.
  [[nodiscard]] std::vector<PairedVersion> paired_versions() const { return visibilities_.versions(); }

  /// Waits for all that is under way; the structure may have changed.
  StepReport finish();

  /// After finish(): what it keeps of its own for each Gaussian, for another one on this model as it is now, on either
  /// device. `memory`: [handover_bytes()] of the host's, 0 so far.
  [[nodiscard]] std::size_t handover_bytes() const;
  void save(std::byte* memory) const;
  /// Goes on with that, page by page; of a page that is not the same any more, everything begins anew. What lies is
  /// refused.
  [[nodiscard]] Restored restore(std::span<const std::byte> memory);

  /// Lets `change` take pages out of the store or put them back, which count as old, and follows.
  void restructure(const std::function<void()>& change);

  /// PageStore::publish(), with bounds that hold for the values as they are.
  void publish(const bus::Publisher& publisher);

  /// Gaussians that were removed because they stood where pictures show free space.
  [[nodiscard]] std::uint64_t carved() const { return carved_; }

 private:
  [[nodiscard]] kernels::PagedGaussians gaussians() const;
  /// Of the average over time, a step: options().ema_decay, or as much more as ema_s of optimizer time takes at
  /// the pace of the steps so far.
  [[nodiscard]] float ema_decay() const;
  /// All pages, where pages are not to rest: nobody would see that one has to train again. After settle().
  void thaw_unseen();
  void collect(bool wait);
  void settle();
  void wait_for_values() const { step_->stream().wait(); }
  void follow(const model::Moves& moves) { follow(moves, store_.step()); }
  void follow(const model::Moves& moves, std::uint64_t created_step);
  void average();
  /// So that none of what trains on for holes and edges grows through the whole picture of who comes near.
  void limit_sizes(std::span<const TrainingViewPtr> views);
  /// Of the objects of the newest view that has trained.
  void list_scales();
  [[nodiscard]] kernels::FrameScales frame_scales() const {
    return {scales_.data(), static_cast<std::uint32_t>(scales_.size())};
  }
  void search_prunable();
  void prune_found(bool waited);
  void look_at(std::span<const TrainingViewPtr> pictures);
  /// Returns whether the structure changed.
  bool carve();
  void remove_dead();
  void densify();
  /// Pages freeze and thaw, when it is time to look at them.
  void rest_settled();

  model::PageStore& store_;
  Options options_;
  std::unique_ptr<GradientStep> step_;
  std::vector<IndexRange> ranges_;  ///< as they were when everything last followed the store
  VisibilityRing visibilities_;
  device::Buffer<IndexRange> fresh_;
  PerIndex<std::uint64_t> created_step_;
  device::Buffer<std::uint8_t> dead_;
  device::Buffer<kernels::PruneCounts> dead_counts_;
  device::Buffer<kernels::FrameScale> scales_;
  TrainingViewPtr newest_view_;
  std::uint64_t launched_ = 0, done_ = 0;  ///< steps
  /// Steps that were launched before a search for Gaussians to remove: it has ended when a later one is done.
  std::optional<std::uint64_t> searched_after_;
  Carver carver_;
  Freezer freezer_;
  std::uint64_t carved_ = 0;
  std::chrono::steady_clock::time_point last_carved_{};
  StepReport report_;
  double unbooked_s_ = 0;  ///< of optimizer time that the model's figures do not have yet
};

}  // namespace splatbus::trainer
