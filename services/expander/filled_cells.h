#pragma once

#include <cstddef>
#include <unordered_map>

#include "expander/cell.h"

namespace splatbus::expander {

/// At which spacing each cell has been filled. A surface is refined by steps: what lies a little apart from all points
/// of a cell is no reason to insert it when the same cell has been filled at about that spacing before, or each new
/// look would add some. Cells are of the level that their samples' spacing has. Not thread-safe.
class FilledCells {
 public:
  /// Whether samples of that mean spacing are to fill their cell now: because much of it `lacks` points, or because
  /// they are finer by `refine_factor` than those that filled it before. Remembers it as filled if so.
  [[nodiscard]] bool fill(const CellKey& cell, float spacing_m, float refine_factor, bool lacks);
  void clear() { spacing_m_.clear(); }
  /// The cell was filled so by the expander before; false when there are too many cells.
  bool restore(const CellKey& cell, float spacing_m);
  /// By cell.
  [[nodiscard]] const std::unordered_map<CellKey, float, CellHash>& all() const { return spacing_m_; }
  [[nodiscard]] std::size_t size() const { return spacing_m_.size(); }

 private:
  [[nodiscard]] const float* find(const CellKey& cell) const;
  [[nodiscard]] bool holds_children_of(const CellKey& cell) const;

  std::unordered_map<CellKey, float, CellHash> spacing_m_;
};

}  // namespace splatbus::expander
