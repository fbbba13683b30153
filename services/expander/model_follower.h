#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

#include "expander/batch_ledger.h"
#include "expander/mapper.h"

namespace splatbus::expander {

/// What a model/published message says about insertion.
struct ModelReport {
  std::uint64_t trainer_epoch = 0;  ///< header.epoch
  std::uint64_t count = 0;
  std::uint64_t insert_epoch = 0;
  std::vector<std::uint64_t> batches;
};

/// Keeps mapper and ledger in step with what the trainer has.
///
/// The trainer lists our batches: they are acknowledged. It is new, or has another expander's batches, and has
/// Gaussians: its model is adopted; the mapper is filled from its points, so that nothing is inserted twice. It is
/// empty although it had acknowledged something, or although it is another trainer than the one before: everything is
/// inserted again.
class ModelFollower {
 public:
  /// Replaces what the mapper has as modelled by the live model's points; false, and nothing is changed, when they
  /// cannot be read now (a newer report is then on its way).
  using AdoptModel = std::function<bool()>;

  explicit ModelFollower(std::uint64_t own_epoch) : own_epoch_(own_epoch) {}

  void follow(const ModelReport& report, const AdoptModel& adopt_model, Mapper& mapper, BatchLedger& ledger);

  /// True once it is known what the trainer has: until then an insertion could double the model.
  [[nodiscard]] bool settled() const { return settled_; }
  [[nodiscard]] std::uint64_t adoptions() const { return adoptions_; }
  [[nodiscard]] std::uint64_t restarts() const { return restarts_; }

 private:
  void after_adoption(Mapper& mapper, BatchLedger& ledger);
  void restart(Mapper& mapper, BatchLedger& ledger);

  std::uint64_t own_epoch_;
  std::uint64_t trainer_epoch_ = 0;
  bool settled_ = false;
  std::uint64_t adoptions_ = 0, restarts_ = 0;
};

}  // namespace splatbus::expander
