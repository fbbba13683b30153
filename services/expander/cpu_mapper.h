#pragma once

#include "expander/grid.h"
#include "expander/mapper.h"

namespace splatbus::expander {

/// The mapper on the host: a Grid, and rounds as InputSamples.
class CpuMapper final : public Mapper {
 public:
  explicit CpuMapper(float cell_size_m);

  [[nodiscard]] Device memory() const override { return Device::Cpu; }
  [[nodiscard]] std::unique_ptr<Round> take(const IncomingRound& round) override;
  [[nodiscard]] Growth grow(const Round& round, const GrowOptions& options) override;
  void add(const InsertBatch& batch) override;
  [[nodiscard]] bool holds_any(const InsertBatch& batch) override;
  [[nodiscard]] bool adopt(const PublishedModel& model) override;
  void clear() override { grid_.clear(); }
  [[nodiscard]] std::vector<CellCounts> cells() override;
  [[nodiscard]] std::size_t cell_count() override { return grid_.cells().size(); }
  [[nodiscard]] std::size_t modelled_points() const override { return grid_.modelled_points(); }

  [[nodiscard]] const Grid& grid() const { return grid_; }

 private:
  Grid grid_;
};

}  // namespace splatbus::expander
