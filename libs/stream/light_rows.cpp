#include "stream/light_rows.h"

#include <algorithm>

#include "stream/all_seen.h"
#include "stream/quantized.h"

namespace splatbus::stream {

bool LightRows::set_lights(std::span<const std::uint32_t> ids, std::size_t slots) {
  const bool same = std::equal(ids.begin(), ids.end(), rows_.begin(), rows_.end(),
                               [](std::uint32_t id, const auto& row) { return id == row.first; });
  if (same) return false;
  std::map<std::uint32_t, Bytes> rows;
  for (const std::uint32_t id : ids) {
    const auto old = rows_.find(id);
    rows.emplace(id, old != rows_.end() ? std::move(old->second) : Bytes(slots, kAllSeen));
  }
  rows_ = std::move(rows);
  return true;
}

void LightRows::resize(std::size_t slots) {
  for (auto& [id, row] : rows_) row.resize(slots, kAllSeen);
}

void LightRows::move(std::size_t from, std::size_t to) {
  for (auto& [id, row] : rows_) row[to] = row[from];
}

void LightRows::forget(std::size_t slot) {
  for (auto& [id, row] : rows_) row[slot] = kAllSeen;
}

Bytes* LightRows::find(std::uint32_t id) {
  const auto found = rows_.find(id);
  return found != rows_.end() ? &found->second : nullptr;
}

std::vector<std::uint32_t> LightRows::ids() const {
  std::vector<std::uint32_t> ids;
  for (const auto& [id, row] : rows_) ids.push_back(id);
  return ids;
}

}  // namespace splatbus::stream
