#include "expander/model_sync.h"

#include <spdlog/spdlog.h>

namespace splatbus::expander {

void ModelSync::follow(const ModelReport& report, const AdoptModel& adopt_model, GaussianInserter& inserter,
                       RetransmitQueue& queue) {
  const bool same_trainer = settled_ && report.trainer_epoch == trainer_epoch_;
  const bool ours = report.insert_epoch == own_epoch_;
  if (ours) queue.acknowledge(report.batches);
  const bool lost = report.count == 0 && !(ours && !report.batches.empty()) && queue.ever_acknowledged();
  // What the expander before has filled was of another model.
  if (!settled_ && report.count == 0 && queue.pending() == 0) inserter.clear();
  const bool another_emptied = settled_ && !same_trainer && report.count == 0;
  stale_ = stale_ || !same_trainer || report.generation != generation_;
  generation_ = report.generation;
  if (lost || another_emptied) {
    restart(inserter, queue);
  } else if (!same_trainer && report.count > 0 && !ours) {
    if (!adopt_model()) return;
    ++adoptions_;
    stale_ = false;
    spdlog::info("adopted a model: {} points", inserter.modelled().size());
    // A batch that went in whole or not at all: pruning may have taken some of it since. The trainer keeps where a
    // Gaussian was inserted to the last bit, so that equality finds it again.
    queue.acknowledge_if([&](const InsertBatch& batch) { return inserter.holds_any(batch); });
    inserter.add(queue.pending_batches());
  }
  trainer_epoch_ = report.trainer_epoch;
  settled_ = true;
}

bool ModelSync::refresh(const AdoptModel& adopt_model, GaussianInserter& inserter, RetransmitQueue& queue) {
  if (!settled_ || !stale_ || !adopt_model()) return false;
  stale_ = false;
  inserter.add(queue.pending_batches());
  return true;
}

void ModelSync::restart(GaussianInserter& inserter, RetransmitQueue& queue) {
  stale_ = false;
  inserter.clear();  // also what was adopted
  if (!queue.ever_acknowledged() && queue.pending() == 0) return;
  ++restarts_;
  queue.restart();
  inserter.add(queue.pending_batches());
  spdlog::info("the trainer has an empty model: inserting {} batches again", queue.pending());
}

}  // namespace splatbus::expander
