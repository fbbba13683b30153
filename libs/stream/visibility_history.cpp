#include "stream/visibility_history.h"

#include <algorithm>
#include <set>
#include <utility>
#include <variant>

#include "stream/all_seen.h"

namespace splatbus::stream {

void VisibilityHistory::add(const DisplayChanges& changes) {
  for (const DisplayChange& change : changes.list()) {
    std::visit([this](const auto& c) { add(c); }, change);
  }
}

void VisibilityHistory::add(const DisplayReset& change) {
  const AttributeChannels* const visibility = change.layout.find(Attribute::Visibility);
  *this = {};
  if (visibility != nullptr) visibility_channel_ = visibility->first;
}

void VisibilityHistory::add(const DisplayRows& change) {
  if (visibility_channel_ < 0 || change.rows.empty()) return;
  const std::size_t rows = std::size_t{1} + *std::ranges::max_element(change.rows);
  if (replaced_in_.size() < rows) replaced_in_.resize(rows, 0);
  for (const std::uint32_t row : change.rows) replaced_in_[row] = open_.number;
  see(0, change.rows, change.gaussians.channels[static_cast<std::size_t>(visibility_channel_)]);
}

void VisibilityHistory::add(const DisplayValues& change) {
  if (change.attribute == Attribute::Visibility) see(0, change.rows, change.values);
}

void VisibilityHistory::add(const DisplayLights& change) {
  forget();
  std::map<std::uint32_t, Bytes> seen;
  for (const std::uint32_t id : change.ids) seen[id] = std::move(seen_[id]);
  seen[0] = std::move(seen_[0]);
  seen_ = std::move(seen);
}

void VisibilityHistory::add(const DisplaySeen& change) {
  // The sun's comes as DisplayValues too.
  if (change.light_id != 0) see(change.light_id, change.rows, change.values);
}

void VisibilityHistory::add(const DisplayVisibility& change) {
  if (visibility_channel_ < 0) return;
  if (open_.version == 0 && open_.lights.empty()) {  // of a model that is about to come
    open_.version = change.scene_version;
    return;
  }
  for (const auto& [light_id, before] : open_.lights) values_ += before.rows.size();
  const std::uint64_t next = open_.number + 1;
  entries_.push_back(std::exchange(open_, {.number = next, .version = change.scene_version, .lights = {}}));
  while (entries_.size() > kMaxEntries || values_ > kMaxValues) {
    for (const auto& [light_id, before] : entries_.front().lights) values_ -= before.rows.size();
    entries_.pop_front();
  }
}

template <class Value>
void VisibilityHistory::see(std::uint32_t light_id, const std::vector<std::uint32_t>& rows,
                            const std::vector<Value>& values) {
  if (rows.empty()) return;
  Bytes& seen = seen_[light_id];
  const std::size_t needed = std::size_t{1} + *std::ranges::max_element(rows);
  if (seen.size() < needed) seen.resize(needed, kAllSeen);
  Before& before = open_.lights[light_id];
  for (std::size_t i = 0; i < rows.size(); ++i) {
    before.rows.push_back(rows[i]);
    before.values.push_back(std::exchange(seen[rows[i]], static_cast<std::uint8_t>(values[i])));
  }
}

void VisibilityHistory::forget() {
  entries_.clear();
  open_.lights.clear();
  values_ = 0;
}

VisibilityHistory::Turn VisibilityHistory::turn_to(std::uint64_t scene_version) {
  const auto distance = [&](const Entry& entry) {
    return entry.version > scene_version ? entry.version - scene_version : scene_version - entry.version;
  };
  std::size_t shown = entries_.size();
  std::uint64_t nearest = distance(open_);
  for (std::size_t k = entries_.size(); k-- > 0;) {
    if (distance(entries_[k]) >= nearest) continue;
    nearest = distance(entries_[k]);
    shown = k;
  }
  if (scene_version == 0) shown = entries_.size();
  Turn turn{.version = shown < entries_.size() ? entries_[shown].version : open_.version, .there = {}, .back = {}};
  if (shown == entries_.size()) return turn;
  std::set<std::uint32_t> lights;
  const auto list = [&](const Entry& entry) {
    for (const auto& [light_id, before] : entry.lights) lights.insert(light_id);
  };
  list(open_);
  for (std::size_t k = entries_.size(); --k > shown;) list(entries_[k]);
  for (const std::uint32_t light_id : lights) {
    Before then;  // a row once
    undo(open_, light_id, then);
    for (std::size_t k = entries_.size(); --k > shown;) undo(entries_[k], light_id, then);
    const Bytes& seen = seen_.at(light_id);
    Bytes now;
    for (const std::uint32_t row : then.rows) {
      now.push_back(seen[row]);
      place_[row] = kNone;
    }
    emit(light_id, then.rows, then.values, turn.there);
    emit(light_id, std::move(then.rows), now, turn.back);
  }
  return turn;
}

void VisibilityHistory::undo(const Entry& entry, std::uint32_t light_id, Before& then) {
  const auto found = entry.lights.find(light_id);
  if (found == entry.lights.end()) return;
  const Before& before = found->second;
  for (std::size_t i = before.rows.size(); i-- > 0;) {
    const std::uint32_t row = before.rows[i];
    if (row < replaced_in_.size() && entry.number <= replaced_in_[row]) continue;
    if (place_.size() <= row) place_.resize(std::size_t{row} + 1, kNone);
    if (place_[row] == kNone) {
      place_[row] = static_cast<std::uint32_t>(then.rows.size());
      then.rows.push_back(row);
      then.values.push_back(before.values[i]);
    } else {
      then.values[place_[row]] = before.values[i];
    }
  }
}

void VisibilityHistory::emit(std::uint32_t light_id, std::vector<std::uint32_t> rows, const Bytes& values,
                             DisplayChanges& out) const {
  if (rows.empty()) return;
  const bool others = std::ranges::any_of(seen_, [](const auto& light) { return light.first != 0; });
  if (light_id != 0 || others) out.add(DisplaySeen{light_id, rows, values});
  if (light_id != 0) return;
  out.add(DisplayValues{.attribute = Attribute::Visibility,
                        .rows = std::move(rows),
                        .values = std::vector<std::int32_t>(values.begin(), values.end())});
}

}  // namespace splatbus::stream
