#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include "bus/backend.h"
#include "expander/grid.h"
#include "expander/insert_batch.h"
#include "expander/round.h"
#include "expander/visibility.h"
#include "wire/published_model.h"

namespace splatbus::expander {

struct MapperOptions {
  float cell_size_m = 0.25F;
  std::uint32_t usual_samples = 1U << 20U;  ///< at least 64: a device has memory ready for rounds of so many
};

/// How a round grows the model.
struct GrowOptions {
  GridOptions grid;  ///< its cell size is the mapper's
  VisibilityOptions visibility;
  InitialOptions initial;
  glm::vec3 viewer{0};
  std::size_t room = SIZE_MAX;     ///< most Gaussians
  std::size_t batch_size = 65536;  ///< most Gaussians of a batch
};

/// What came of a round.
struct Growth {
  std::size_t unseen = 0;            ///< samples that their cameras do not really see
  std::size_t chosen = 0;            ///< Gaussians of all batches
  std::vector<InsertBatch> batches;  ///< in the order of the round; not numbered
};

/// What the grid knows of one cell.
struct CellCounts {
  CellId cell = kNoCell;
  std::uint32_t samples = 0;  ///< in the last round that saw it
  std::uint32_t points = 0;   ///< modelled
};

/// Knows what is modelled, and makes Gaussians of the samples that are not: the expander's bulk work, on one backend.
/// All backends give the same cells and Gaussians. Rounds and batches live in memory() and are used with the mapper
/// that made them. Not thread-safe, and rounds and batches are let go on the thread that uses the mapper.
///
/// Functions throw bus::Error or std::runtime_error, which says how much was asked for, when memory or the device
/// fails; what is modelled has not changed then.
class Mapper {
 public:
  virtual ~Mapper() = default;

  [[nodiscard]] virtual Device memory() const = 0;

  /// Copies a round from wherever it lies and leaves out samples that are garbage. Null when a slab has moved on
  /// meanwhile.
  [[nodiscard]] virtual std::unique_ptr<Round> take(const IncomingRound& round) = 0;

  /// Makes Gaussians of what the round shows and the model lacks (Grid::choose has the rules), and remembers them as
  /// modelled. The batches are complete: no stream writes them any more.
  [[nodiscard]] virtual Growth grow(const Round& round, const GrowOptions& options) = 0;

  /// Marks a batch's points as modelled.
  virtual void add(const InsertBatch& batch) = 0;
  /// True when any point of the batch is modelled, to the last bit.
  [[nodiscard]] virtual bool holds_any(const InsertBatch& batch) = 0;
  /// Marks a live model's points as modelled, and nothing else. False, and nothing is changed, when its structure moved
  /// on meanwhile. The model was opened in memory().
  [[nodiscard]] virtual bool adopt(const PublishedModel& model) = 0;
  virtual void clear() = 0;

  /// Bounds the device memory of rounds, batches and what is modelled: more is not asked for. Slabs are beside it; a
  /// backend without device memory takes no notice.
  virtual void limit_device_memory(std::size_t /*most_bytes*/) {}

  [[nodiscard]] virtual std::vector<CellCounts> cells() = 0;
  [[nodiscard]] virtual std::size_t cell_count() = 0;
  [[nodiscard]] virtual std::size_t modelled_points() const = 0;

  /// Bulk data that has passed through host memory. Any thread.
  [[nodiscard]] std::uint64_t host_copied_bytes() const { return host_bytes_; }

 protected:
  std::atomic<std::uint64_t> host_bytes_{0};
};

/// Throws when the backend cannot be had.
[[nodiscard]] std::unique_ptr<Mapper> make_mapper(Device backend, const MapperOptions& options);

}  // namespace splatbus::expander
