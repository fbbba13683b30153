#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <set>
#include <span>
#include <vector>

#include "expander/cell.h"
#include "expander/insertion.h"

namespace splatbus::expander {

/// What grid/state says of a cell.
struct CellReport {
  CellKey key;
  std::uint32_t samples = 0;   ///< in the last round that saw it
  std::uint32_t modelled = 0;  ///< points
};

/// What is known of each cell, and which of it has still to be told. Not thread-safe.
class CellTable {
 public:
  /// Cells beyond `max_cells` are left out.
  explicit CellTable(std::size_t max_cells) : max_cells_(max_cells) {}

  /// The cells that a round has samples in.
  void set_samples(std::span<const CellCount> cells);
  /// The cells that are modelled; all others are not.
  void set_modelled(std::span<const CellCount> cells);

  /// At most `max` cells that have changed since they were taken last. A cell that has neither samples nor points is
  /// told once and forgotten.
  [[nodiscard]] std::vector<CellReport> take_changed(std::size_t max);
  /// All cells count as changed.
  void touch_all();

  [[nodiscard]] bool changed() const { return !changed_.empty(); }
  [[nodiscard]] bool full() const { return cells_.size() >= max_cells_; }
  [[nodiscard]] std::size_t size() const { return cells_.size(); }
  [[nodiscard]] std::size_t seen() const { return seen_; }
  [[nodiscard]] std::size_t modelled() const { return modelled_; }

 private:
  struct Counts {
    std::uint32_t samples = 0, modelled = 0;
  };
  void set(const CellKey& key, std::uint32_t Counts::*field, std::uint32_t count);

  std::size_t max_cells_;
  std::map<CellKey, Counts> cells_;
  std::set<CellKey> changed_;
  std::size_t seen_ = 0, modelled_ = 0;  // cells with samples, with points
};

}  // namespace splatbus::expander
