#include "expander/model_follower.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <bit>
#include <unordered_set>

namespace splatbus::expander {

namespace {

/// The trainer keeps where a Gaussian was inserted to the last bit, so that equality finds it again.
struct ExactPoint {
  glm::vec3 position;
  bool operator==(const ExactPoint&) const = default;
};

struct ExactHash {
  std::size_t operator()(const ExactPoint& point) const {
    std::uint64_t hash = 0xcbf29ce484222325;
    for (int c = 0; c < 3; ++c) hash = (hash ^ std::bit_cast<std::uint32_t>(point.position[c])) * 0x100000001b3;
    return hash ^ hash >> 29U;
  }
};

glm::vec3 vector_at(const std::vector<float>& planes, std::size_t count, std::size_t i) {
  return {planes[i], planes[count + i], planes[2 * count + i]};
}

Frame frame_of(CellId cell, std::uint32_t object_id) {
  return {.local = (cell & kObjectCell) != 0, .object_id = object_id};
}

}  // namespace

void add_batch(const InsertBatch& batch, Grid& grid) {
  for (std::size_t i = 0; i < batch.size(); ++i) {
    grid.add_modelled(frame_of(batch.cell[i], batch.object_id[i]), vector_at(batch.mean, batch.size(), i),
                      vector_at(batch.normal, batch.size(), i));
  }
}

void ModelFollower::follow(const ModelReport& report, const ReadPoints& read_points, Grid& grid, BatchLedger& ledger) {
  const bool same_trainer = settled_ && report.trainer_epoch == trainer_epoch_;
  const bool ours = report.insert_epoch == own_epoch_;
  if (ours) ledger.acknowledge(report.batches);
  const bool lost = report.count == 0 && !(ours && !report.batches.empty()) && ledger.ever_acknowledged();
  const bool another_emptied = settled_ && !same_trainer && report.count == 0;
  if (lost || another_emptied) {
    restart(grid, ledger);
  } else if (!same_trainer && report.count > 0 && !ours) {
    ModelPoints points;
    if (!read_points(points)) return;
    adopt(points, grid, ledger);
  }
  trainer_epoch_ = report.trainer_epoch;
  settled_ = true;
}

void ModelFollower::adopt(const ModelPoints& points, Grid& grid, BatchLedger& ledger) {
  ++adoptions_;
  std::unordered_set<ExactPoint, ExactHash> exact;
  grid.clear();
  for (std::size_t i = 0; i < points.position.size(); ++i) {
    grid.add_modelled(frame_of(points.cell[i], points.object_id[i]), points.position[i], points.normal[i]);
    exact.insert({points.position[i]});
  }
  // A batch that went in whole or not at all: pruning may have taken some of it since.
  ledger.acknowledge_if([&](const InsertBatch& batch) {
    for (std::size_t i = 0; i < batch.size(); ++i) {
      if (exact.contains({vector_at(batch.mean, batch.size(), i)})) return true;
    }
    return false;
  });
  for (const InsertBatch* batch : ledger.pending_batches()) add_batch(*batch, grid);
  spdlog::info("adopted a model of {} Gaussians in {} cells", points.position.size(), grid.modelled_cells());
}

void ModelFollower::restart(Grid& grid, BatchLedger& ledger) {
  if (!ledger.ever_acknowledged() && ledger.pending() == 0) return;
  ++restarts_;
  ledger.restart();
  grid.clear();
  for (const InsertBatch* batch : ledger.pending_batches()) add_batch(*batch, grid);
  spdlog::info("the trainer has an empty model: inserting {} batches again", ledger.pending());
}

}  // namespace splatbus::expander
