#include "expander/cell_table.h"

namespace splatbus::expander {

void CellTable::set(const CellKey& key, std::uint32_t Counts::*field, std::uint32_t count) {
  auto found = cells_.find(key);
  if (found == cells_.end()) {
    if (count == 0 || full()) return;
    found = cells_.emplace(key, Counts()).first;
  }
  std::uint32_t& value = found->second.*field;
  if (value == count) return;
  std::size_t& cells = field == &Counts::samples ? seen_ : modelled_;
  if (value == 0) ++cells;
  if (count == 0) --cells;
  value = count;
  changed_.insert(key);
}

void CellTable::set_samples(std::span<const CellCount> cells) {
  for (const CellCount& cell : cells) set(cell.key, &Counts::samples, cell.count);
}

void CellTable::set_modelled(std::span<const CellCount> cells) {
  auto next = cells.begin();  // ascending, as the table is
  for (auto& [key, counts] : cells_) {
    while (next != cells.end() && next->key < key) ++next;
    if (next == cells.end() || !(next->key == key)) set(key, &Counts::modelled, 0);
  }
  for (const CellCount& cell : cells) set(cell.key, &Counts::modelled, cell.count);
}

std::vector<CellReport> CellTable::take_changed(std::size_t max) {
  std::vector<CellReport> reports;
  while (!changed_.empty() && reports.size() < max) {
    const auto found = cells_.find(*changed_.begin());
    changed_.erase(changed_.begin());
    const Counts counts = found->second;
    reports.push_back({found->first, counts.samples, counts.modelled});
    if (counts.samples == 0 && counts.modelled == 0) cells_.erase(found);
  }
  return reports;
}

void CellTable::touch_all() {
  for (const auto& [key, counts] : cells_) changed_.insert(key);
}

}  // namespace splatbus::expander
