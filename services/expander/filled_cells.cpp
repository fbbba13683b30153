#include "expander/filled_cells.h"

namespace splatbus::expander {

namespace {

constexpr float kLargerCellFactor = 1.25F;
// Then all is forgotten: a cell counts as filled at the first spacing that is seen.
constexpr std::size_t kMostCells = std::size_t{1} << 21U;

}  // namespace

const float* FilledCells::find(const CellKey& cell) const {
  const auto found = spacing_m_.find(cell);
  return found == spacing_m_.end() ? nullptr : &found->second;
}

bool FilledCells::holds_children_of(const CellKey& cell) const {
  if (cell.level == 0) return false;
  CellKey child = first_in(cell, cell.level - 1);
  for (const CellKey end = first_in(next_of(cell), cell.level - 1); child < end; child = next_of(child)) {
    if (spacing_m_.contains(child)) return true;
  }
  return false;
}

bool FilledCells::restore(const CellKey& cell, float spacing_m) {
  if (spacing_m_.size() >= kMostCells) return false;
  spacing_m_.insert_or_assign(cell, spacing_m);
  return true;
}

bool FilledCells::fill(const CellKey& cell, float spacing_m, float refine_factor, bool lacks) {
  const float* before = find(cell);
  // What was seen from farther away was filled by cells of the next size, and from nearer by smaller ones. A larger
  // cell has a mean of more, some of which was as fine.
  float factor = refine_factor;
  if (before == nullptr && !holds_children_of(cell) && cell.level + 1 < kLevels) {
    before = find(parent_of(cell, cell.level + 1));
    factor *= kLargerCellFactor;
  }
  const bool fills = lacks || (before != nullptr && spacing_m * factor < *before);
  // Without a memory of it the model's points stand for a fill at this spacing: another expander's are not doubled.
  if (!fills && before != nullptr) return fills;
  if (spacing_m_.size() >= kMostCells) spacing_m_.clear();
  spacing_m_.insert_or_assign(cell, spacing_m);
  return fills;
}

}  // namespace splatbus::expander
