#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <span>
#include <unordered_map>
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

/// What is known of each cell, and which of it has still to be told. Any change costs what the changed cells do,
/// however many there are. Not thread-safe.
class CellTable {
 public:
  /// Cells beyond `max_cells` are left out.
  explicit CellTable(std::size_t max_cells) : max_cells_(max_cells) {}

  /// The cells that a round has samples in.
  void set_samples(std::span<const CellCount> cells);
  /// Points that have come to be modelled, or are modelled no longer.
  void add_modelled(std::span<const CellCount> cells);
  void remove_modelled(std::span<const CellCount> cells);

  /// At most `max` cells that are not as they were told last, and after them at most `repeats` others, each of
  /// them again after all the rest. A cell that has neither samples nor points is told once and forgotten.
  [[nodiscard]] std::vector<CellReport> take(std::size_t max, std::size_t repeats);

  /// Cells that a round had samples in, and how many in the last that had.
  [[nodiscard]] std::vector<CellCount> sampled() const;
  [[nodiscard]] bool changed() const { return !changed_.empty(); }
  [[nodiscard]] bool full() const { return places_.size() >= max_cells_; }
  [[nodiscard]] std::size_t size() const { return places_.size(); }
  [[nodiscard]] std::size_t seen() const { return seen_; }
  [[nodiscard]] std::size_t modelled() const { return modelled_; }
  [[nodiscard]] std::uint32_t modelled_of(const CellKey& key) const;

 private:
  struct Cell {
    CellReport report;
    std::uint32_t told_samples = 0, told_modelled = 0;
    bool changed = false;  // and in changed_
  };
  /// Null when there is no such cell and no room for one.
  [[nodiscard]] Cell* find_or_add(const CellKey& key);
  [[nodiscard]] Cell* find(const CellKey& key);
  void mark(Cell& cell);
  void set(Cell& cell, std::uint32_t CellReport::*field, std::size_t& cells, std::uint32_t count);
  void forget(std::uint32_t place);

  std::size_t max_cells_;
  std::vector<Cell> cells_;
  std::unordered_map<CellKey, std::uint32_t, CellHash> places_;  // in cells_
  std::deque<CellKey> changed_;
  std::size_t repeated_ = 0;             // place of the next that is told again
  std::size_t seen_ = 0, modelled_ = 0;  // cells with samples, with points
};

}  // namespace splatbus::expander
