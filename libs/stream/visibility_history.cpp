#include "stream/visibility_history.h"

#include <algorithm>
#include <iterator>
#include <set>
#include <utility>
#include <variant>

#include "stream/all_seen.h"

namespace splatbus::stream {

namespace {

/// Versions within which what is said of a Gaussian that has come is the first that is known of it: relight sees a
/// model a moment after viewers do. Where nothing is said, what it came with was right.
constexpr std::uint32_t kFirstLook = 4;

}  // namespace

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
  if (came_in_.size() < rows) {
    came_in_.resize(rows, 0);
    awaits_.resize(rows, 0);
  }
  for (const std::uint32_t row : change.rows) came_in_[row] = open_.number;
  see(0, change.rows, change.gaussians.channels[static_cast<std::size_t>(visibility_channel_)]);
  for (const std::uint32_t row : change.rows) awaits_[row] = ~std::uint32_t{0};
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
  if (open_.version == 0) {  // of a model that is about to come
    open_.version = change.scene_version;
    return;
  }
  const std::uint32_t next = open_.number + 1;
  entries_.push_back(std::exchange(open_, {.number = next, .version = change.scene_version, .lights = {}}));
  while (entries_.size() > kMaxEntries) drop_oldest();
}

template <class Value>
void VisibilityHistory::see(std::uint32_t light_id, const std::vector<std::uint32_t>& rows,
                            const std::vector<Value>& values) {
  if (rows.empty()) return;
  Bytes& seen = seen_[light_id];
  const std::uint32_t light = std::uint32_t{1} << (std::distance(seen_.begin(), seen_.find(light_id)) % 32);
  const std::size_t needed = std::size_t{1} + *std::ranges::max_element(rows);
  if (seen.size() < needed) seen.resize(needed, kAllSeen);
  Before* const before = entries_.empty() ? nullptr : &open_.lights[light_id];
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const std::uint32_t row = rows[i];
    const std::uint8_t was = std::exchange(seen[row], static_cast<std::uint8_t>(values[i]));
    if (row < came_in_.size()) {
      if ((awaits_[row] & light) != 0) {
        awaits_[row] &= ~light;
        if (open_.number - came_in_[row] <= kFirstLook) came_in_[row] = open_.number;
      }
      if (came_in_[row] == open_.number) continue;
    }
    if (before == nullptr) continue;
    before->rows.push_back(row);
    before->values.push_back(was);
    ++values_;
  }
  while (values_ > kMaxValues) drop_oldest();
}

std::size_t VisibilityHistory::values_of(const Entry& entry) {
  std::size_t count = 0;
  for (const auto& [light_id, before] : entry.lights) count += before.rows.size();
  return count;
}

void VisibilityHistory::drop_oldest() {
  if (!entries_.empty()) {
    values_ -= values_of(entries_.front());
    entries_.pop_front();
  }
  Entry& first = entries_.empty() ? open_ : entries_.front();
  values_ -= values_of(first);
  first.lights.clear();
}

void VisibilityHistory::forget() {
  entries_.clear();
  open_.lights.clear();
  values_ = 0;
}

std::size_t VisibilityHistory::find(std::uint64_t scene_version) const {
  const auto distance = [&](std::uint64_t version) {
    return version > scene_version ? version - scene_version : scene_version - version;
  };
  std::size_t found = entries_.size();
  if (scene_version == 0) return found;
  std::uint64_t least = distance(open_.version);
  for (std::size_t k = entries_.size(); k-- > 0;) {
    if (distance(entries_[k].version) >= least) continue;
    least = distance(entries_[k].version);
    found = k;
  }
  return found;
}

VisibilityHistory::Turn VisibilityHistory::turn_to(std::uint64_t scene_version) {
  const std::size_t shown = find(scene_version);
  Turn turn{.version = version_of(shown), .there = {}, .back = {}};
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
    now.reserve(then.rows.size());
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
    if (row < came_in_.size() && entry.number <= came_in_[row]) continue;
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
