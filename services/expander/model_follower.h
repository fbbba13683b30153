#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <vector>

#include "expander/batch_ledger.h"
#include "expander/grid.h"

namespace splatbus::expander {

/// What a model/published message says about insertion.
struct ModelReport {
  std::uint64_t trainer_epoch = 0;  ///< header.epoch
  std::uint64_t count = 0;
  std::uint64_t insert_epoch = 0;
  std::vector<std::uint64_t> batches;
};

/// The points of a live model.
struct ModelPoints {
  std::vector<glm::vec3> position, normal;  ///< where the samples were, in the frame that the cell says
  std::vector<std::uint32_t> object_id;
  std::vector<CellId> cell;
};

/// Keeps grid and ledger in step with what the trainer has.
///
/// The trainer lists our batches: they are acknowledged. It is new, or has another expander's batches, and has
/// Gaussians: its model is adopted; the grid is filled from its points, so that nothing is inserted twice. It is empty
/// although it had acknowledged something, or although it is another trainer than the one before: everything is
/// inserted again.
class ModelFollower {
 public:
  /// Reads the live model's points; false when they cannot be read now (a newer report is then on its way).
  using ReadPoints = std::function<bool(ModelPoints&)>;

  explicit ModelFollower(std::uint64_t own_epoch) : own_epoch_(own_epoch) {}

  void follow(const ModelReport& report, const ReadPoints& read_points, Grid& grid, BatchLedger& ledger);

  /// True once it is known what the trainer has: until then an insertion could double the model.
  [[nodiscard]] bool settled() const { return settled_; }
  [[nodiscard]] std::uint64_t adoptions() const { return adoptions_; }
  [[nodiscard]] std::uint64_t restarts() const { return restarts_; }

 private:
  void adopt(const ModelPoints& points, Grid& grid, BatchLedger& ledger);
  void restart(Grid& grid, BatchLedger& ledger);

  std::uint64_t own_epoch_;
  std::uint64_t trainer_epoch_ = 0;
  bool settled_ = false;
  std::uint64_t adoptions_ = 0, restarts_ = 0;
};

/// Marks a batch's points as modelled.
void add_batch(const InsertBatch& batch, Grid& grid);

}  // namespace splatbus::expander
