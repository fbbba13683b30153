#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

#include "expander/gaussian_inserter.h"
#include "expander/retransmit_queue.h"

namespace splatbus::expander {

/// What a model/published message says about insertion.
struct ModelReport {
  std::uint64_t trainer_epoch = 0;  ///< header.epoch
  std::uint64_t generation = 0;     ///< of the model's structure
  std::uint64_t count = 0;
  std::uint64_t insert_epoch = 0;
  std::vector<std::uint64_t> batches;
};

/// Keeps what counts as modelled, and the queue of batches, in step with what the trainer has.
///
/// The trainer lists our batches: they are acknowledged. It is new, or has another expander's batches, and has
/// Gaussians: its model is adopted, so that nothing is inserted twice. It is empty although it had acknowledged
/// something, or although it is another trainer than the one before: everything is inserted again. Its structure has
/// changed: before the next insertion its points are read again, so that what it has removed counts as modelled no
/// longer.
class ModelSync {
 public:
  /// Replaces what counts as modelled by the live model's points; false, and nothing is changed, when they cannot be
  /// read now (a newer report is then on its way).
  using AdoptModel = std::function<bool()>;

  explicit ModelSync(std::uint64_t own_epoch) : own_epoch_(own_epoch) {}

  void follow(const ModelReport& report, const AdoptModel& adopt_model, GaussianInserter& inserter,
              RetransmitQueue& queue);

  /// Reads the model's points again if its structure has changed since that was done last; true when it did.
  bool refresh(const AdoptModel& adopt_model, GaussianInserter& inserter, RetransmitQueue& queue);

  /// True once it is known what the trainer has: until then an insertion could double the model.
  [[nodiscard]] bool settled() const { return settled_; }
  /// The structure that a trainer has told of last.
  [[nodiscard]] std::uint64_t generation() const { return generation_; }
  [[nodiscard]] std::uint64_t adoptions() const { return adoptions_; }
  [[nodiscard]] std::uint64_t restarts() const { return restarts_; }

 private:
  void restart(GaussianInserter& inserter, RetransmitQueue& queue);

  std::uint64_t own_epoch_;
  std::uint64_t trainer_epoch_ = 0;
  std::uint64_t generation_ = 0;
  bool settled_ = false, stale_ = false;  // stale: the structure has changed since its points were read
  std::uint64_t adoptions_ = 0, restarts_ = 0;
};

}  // namespace splatbus::expander
