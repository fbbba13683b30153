#include "expander/cell_table.h"

#include <algorithm>

namespace splatbus::expander {

CellTable::Cell* CellTable::find(const CellKey& key) {
  const auto found = places_.find(key);
  return found == places_.end() ? nullptr : &cells_[found->second];
}

CellTable::Cell* CellTable::find_or_add(const CellKey& key) {
  if (Cell* const cell = find(key)) return cell;
  if (full()) return nullptr;
  places_.emplace(key, static_cast<std::uint32_t>(cells_.size()));
  cells_.push_back({.report = {.key = key}});
  return &cells_.back();
}

void CellTable::mark(Cell& cell) {
  if (cell.changed) return;
  cell.changed = true;
  changed_.push_back(cell.report.key);
}

void CellTable::set(Cell& cell, std::uint32_t CellReport::*field, std::size_t& cells, std::uint32_t count) {
  std::uint32_t& value = cell.report.*field;
  if (value == count) return;
  if (value == 0) ++cells;
  if (count == 0) --cells;
  value = count;
  mark(cell);
}

void CellTable::set_samples(std::span<const CellCount> cells) {
  for (const CellCount& count : cells) {
    if (Cell* const cell = find_or_add(count.key)) set(*cell, &CellReport::samples, seen_, count.count);
  }
}

std::vector<CellCount> CellTable::sampled() const {
  std::vector<CellCount> counts;
  for (const Cell& cell : cells_) {
    if (cell.report.samples > 0) counts.push_back({.key = cell.report.key, .count = cell.report.samples});
  }
  return counts;
}

void CellTable::add_modelled(std::span<const CellCount> cells) {
  for (const CellCount& count : cells) {
    Cell* const cell = find_or_add(count.key);
    if (cell != nullptr) set(*cell, &CellReport::modelled, modelled_, cell->report.modelled + count.count);
  }
}

void CellTable::remove_modelled(std::span<const CellCount> cells) {
  for (const CellCount& count : cells) {
    Cell* const cell = find(count.key);
    // Fewer than are removed where there was no room for the cell as they came.
    if (cell == nullptr) continue;
    set(*cell, &CellReport::modelled, modelled_, cell->report.modelled - std::min(cell->report.modelled, count.count));
  }
}

std::vector<CellReport> CellTable::take(std::size_t max, std::size_t repeats) {
  std::vector<CellReport> reports;
  while (!changed_.empty() && reports.size() < max) {
    const auto found = places_.find(changed_.front());
    changed_.pop_front();
    Cell& cell = cells_[found->second];
    cell.changed = false;
    const CellReport now = cell.report;
    if (now.samples != cell.told_samples || now.modelled != cell.told_modelled) {
      reports.push_back(now);
      cell.told_samples = now.samples;
      cell.told_modelled = now.modelled;
    }
    if (now.samples == 0 && now.modelled == 0) forget(found->second);
  }
  const std::size_t most = std::min({repeats, max - reports.size(), cells_.size()});
  for (std::size_t i = 0; i < most; ++i) {
    if (repeated_ >= cells_.size()) repeated_ = 0;
    reports.push_back(cells_[repeated_++].report);
  }
  return reports;
}

void CellTable::forget(std::uint32_t place) {
  places_.erase(cells_[place].report.key);
  if (place + 1 < cells_.size()) {
    cells_[place] = cells_.back();
    places_[cells_[place].report.key] = place;
  }
  cells_.pop_back();
}

std::uint32_t CellTable::modelled_of(const CellKey& key) const {
  const auto found = places_.find(key);
  return found == places_.end() ? 0 : cells_[found->second].report.modelled;
}

}  // namespace splatbus::expander
