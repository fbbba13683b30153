#include "expander/model_follower.h"

#include <spdlog/spdlog.h>

namespace splatbus::expander {

void ModelFollower::follow(const ModelReport& report, const AdoptModel& adopt_model, Mapper& mapper,
                           BatchLedger& ledger) {
  const bool same_trainer = settled_ && report.trainer_epoch == trainer_epoch_;
  const bool ours = report.insert_epoch == own_epoch_;
  if (ours) ledger.acknowledge(report.batches);
  const bool lost = report.count == 0 && !(ours && !report.batches.empty()) && ledger.ever_acknowledged();
  const bool another_emptied = settled_ && !same_trainer && report.count == 0;
  if (lost || another_emptied) {
    restart(mapper, ledger);
  } else if (!same_trainer && report.count > 0 && !ours) {
    if (!adopt_model()) return;
    after_adoption(mapper, ledger);
  }
  trainer_epoch_ = report.trainer_epoch;
  settled_ = true;
}

void ModelFollower::after_adoption(Mapper& mapper, BatchLedger& ledger) {
  ++adoptions_;
  spdlog::info("adopted a model: {} points in {} cells", mapper.modelled_points(), mapper.cell_count());
  // A batch that went in whole or not at all: pruning may have taken some of it since. The trainer keeps where a
  // Gaussian was inserted to the last bit, so that equality finds it again.
  ledger.acknowledge_if([&](const InsertBatch& batch) { return mapper.holds_any(batch); });
  for (const InsertBatch* batch : ledger.pending_batches()) mapper.add(*batch);
}

void ModelFollower::restart(Mapper& mapper, BatchLedger& ledger) {
  if (!ledger.ever_acknowledged() && ledger.pending() == 0) return;
  ++restarts_;
  ledger.restart();
  mapper.clear();
  for (const InsertBatch* batch : ledger.pending_batches()) mapper.add(*batch);
  spdlog::info("the trainer has an empty model: inserting {} batches again", ledger.pending());
}

}  // namespace splatbus::expander
