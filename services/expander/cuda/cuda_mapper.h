#pragma once

#include <unordered_map>
#include <vector>

#include "device/pinned.h"
#include "expander/cuda/choice_workspace.h"
#include "expander/cuda/device_round.h"
#include "expander/cuda/modelled_points.h"
#include "expander/cuda/pool.h"
#include "expander/mapper.h"

namespace splatbus::expander::cuda {

/// The mapper on the first CUDA device: rounds, modelled points and batches stay in its memory; the host sees counts,
/// and a row for each cell. Works on the calling thread's own stream.
class CudaMapper final : public Mapper {
 public:
  /// Takes memory for usual rounds and loads all kernels, which takes a while, so that the first round does not.
  explicit CudaMapper(const MapperOptions& options);

  [[nodiscard]] Device memory() const override { return Device::Cuda; }
  [[nodiscard]] std::unique_ptr<Round> take(const IncomingRound& round) override;
  [[nodiscard]] Growth grow(const Round& round, const GrowOptions& options) override;
  void add(const InsertBatch& batch) override;
  [[nodiscard]] bool holds_any(const InsertBatch& batch) override;
  [[nodiscard]] bool adopt(const PublishedModel& model) override;
  void clear() override;
  void limit_device_memory(std::size_t most_bytes) override { pool_.limit(most_bytes); }
  [[nodiscard]] std::vector<CellCounts> cells() override;
  [[nodiscard]] std::size_t cell_count() override;
  [[nodiscard]] std::size_t modelled_points() const override { return modelled_.size(); }

 private:
  struct Counts {
    std::uint32_t unseen, chosen, cells;
  };

  void warm_up(std::uint32_t usual_samples);
  [[nodiscard]] Counts choose(const RoundView& round, const GrowOptions& options);
  [[nodiscard]] std::vector<InsertBatch> make_batches(const DeviceRound& round, std::uint32_t count,
                                                      const GrowOptions& options);
  void fetch_rows(std::uint32_t cells);
  void note_rows(std::uint32_t cells);
  void refresh_points();

  float cell_size_m_;
  Pool pool_;
  ModelledPoints modelled_;
  ChoiceWorkspace workspace_;
  device::Pinned<Counts> counts_;

  // A row for each cell of the last round, as they come from the device.
  device::Pinned<std::uint64_t> row_cell_;
  device::Pinned<std::uint32_t> row_start_, row_inserted_;

  struct CellRow {
    std::uint32_t samples = 0, points = 0;
  };
  std::unordered_map<CellId, CellRow> rows_;
  bool points_stale_ = false;  // rows_ says nothing of points that were added otherwise than by a round
};

}  // namespace splatbus::expander::cuda
