#pragma once

#include <atomic>
#include <cstdint>
#include <limits>
#include <memory>
#include <vector>

#include "expander/cell_table.h"
#include "expander/filled_cells.h"
#include "expander/insert_batch.h"
#include "expander/modelled_points.h"
#include "expander/round.h"
#include "model/published_model.h"

namespace splatbus::expander {

struct InsertOptions {
  SelectOptions select;
  InitialOptions initial;
  std::size_t batch_size = 65536;  ///< most Gaussians of a batch
};

struct InsertResult {
  std::size_t selected = 0;  ///< Gaussians of all batches
  InsertReasons reasons;
  std::size_t beyond = 0;            ///< candidates that lie too far from their frame's origin for any cell
  std::vector<CellCount> cells;      ///< with candidates, and how many
  std::vector<InsertBatch> batches;  ///< in the order of the round; not numbered
};

/// Knows what is modelled, and makes Gaussians of the samples that are not, on one device. Rounds, batches and models
/// live on that device. Used by one thread, which also lets rounds and batches go. Throws as insertion.h: what is
/// modelled is then unknown.
class GaussianInserter {
 public:
  GaussianInserter(Device device, float cell_size_m, std::size_t max_cells = std::numeric_limits<std::uint32_t>::max());

  [[nodiscard]] Device memory() const { return stream_.device; }

  /// take_round() to this device.
  [[nodiscard]] std::unique_ptr<Round> take(const IncomingRound& incoming) {
    return take_round(incoming, stream_, host_bytes_);
  }

  /// Makes Gaussians of what the round shows and the model lacks (SampleSelector::select has the rules), and remembers
  /// them as modelled. The batches are complete: no stream writes them any more.
  [[nodiscard]] InsertResult insert(const Round& round, std::span<const Viewpoint> viewpoints,
                                    const InsertOptions& options);

  /// Marks the batches' points as modelled.
  void add(std::span<const InsertBatch* const> batches) { modelled_.add(batches); }
  /// True when any point of the batch is modelled, to the last bit.
  [[nodiscard]] bool holds_any(const InsertBatch& batch) { return modelled_.holds_any(batch); }
  /// Marks a live model's points as modelled, and nothing else. False, and nothing is changed, when its structure moved
  /// on meanwhile. The model was opened in memory().
  [[nodiscard]] bool adopt(const PublishedModel& model, std::uint64_t trainer_epoch);
  void clear() {
    modelled_.clear();
    filled_.clear();
  }

  [[nodiscard]] CellTable& cells() { return cells_; }
  [[nodiscard]] const CellTable& cells() const { return cells_; }
  [[nodiscard]] FilledCells& filled() { return filled_; }
  [[nodiscard]] const ModelledPoints& modelled() const { return modelled_; }

  /// Bulk data that has passed through host memory. Any thread.
  [[nodiscard]] std::uint64_t host_copied_bytes() const { return host_bytes_; }

 private:
  device::StreamView stream_;
  CellTable cells_;
  ModelledPoints modelled_;
  SampleSelector selector_;
  FilledCells filled_;
  std::atomic<std::uint64_t> host_bytes_{0};
};

}  // namespace splatbus::expander
