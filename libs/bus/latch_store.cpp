#include "bus/latch_store.h"

#include <algorithm>

namespace splatbus::bus {

std::size_t LatchStore::put(const std::string& topic, const std::string& key, std::uint64_t order, Frames frames,
                            std::int64_t stamp) {
  erase(topic, key);
  bytes_ += frames.bytes();
  by_order_.emplace(order, Key(topic, key));
  held_.emplace(Key(topic, key), Held{order, stamp, std::move(frames)});
  return evict();
}

LatchStore::Held* LatchStore::find(const std::string& topic, const std::string& key) {
  const auto found = held_.find(Key(topic, key));
  return found == held_.end() ? nullptr : &found->second;
}

void LatchStore::erase(const std::string& topic, const std::string& key) {
  const auto found = held_.find(Key(topic, key));
  if (found == held_.end()) return;
  bytes_ -= found->second.frames.bytes();
  by_order_.erase(found->second.order);
  held_.erase(found);
}

std::vector<LatchStore::Held> LatchStore::matching(std::string_view prefix) {
  std::vector<Held> result;
  for (auto it = held_.lower_bound(Key(prefix, "")); it != held_.end(); ++it) {
    if (!std::string_view(it->first.first).starts_with(prefix)) break;
    result.push_back({it->second.order, it->second.stamp, it->second.frames.share()});
  }
  std::sort(result.begin(), result.end(), [](const Held& a, const Held& b) { return a.order < b.order; });
  return result;
}

std::size_t LatchStore::evict() {
  std::size_t evicted = 0;
  while (!by_order_.empty() && (held_.size() > max_messages_ || bytes_ > max_bytes_)) {
    const Key oldest = by_order_.begin()->second;
    erase(oldest.first, oldest.second);
    ++evicted;
  }
  return evicted;
}

}  // namespace splatbus::bus
