#include "bus/latch_store.h"

#include <algorithm>

namespace splatbus::bus {

LatchStore::LatchStore(std::size_t max_messages, std::size_t max_bytes, double share)
    : max_messages_(max_messages),
      max_bytes_(max_bytes),
      max_messages_of_one_(
          std::max<std::size_t>(1, static_cast<std::size_t>(static_cast<double>(max_messages) * share))),
      max_bytes_of_one_(static_cast<std::size_t>(static_cast<double>(max_bytes) * share)) {}

LatchStore::Put LatchStore::put(const std::string& topic, const std::string& key, const std::string& source,
                                std::uint64_t order, Frames frames, std::int64_t stamp, bool far) {
  erase(topic, key);
  const std::size_t bytes = frames.bytes();
  if (bytes > max_bytes_of_one_) return {};
  Share& share = sources_[{far, source}];
  bytes_ += bytes;
  share.bytes += bytes;
  if (far) far_ = {far_.messages + 1, far_.bytes + bytes};
  share.by_order.emplace(order, Key(topic, key));
  held_.emplace(Key(topic, key), Held{order, stamp, std::move(frames), source, far});

  Put result{.held = true};
  const auto erase_one = [&](const Source& of) {
    // Of who holds the most it may be the last, and that only.
    const bool is_it = sources_.at(of).by_order.begin()->first == order;
    erase_oldest(of);
    if (is_it) result.held = false;
    if (!is_it) ++result.evicted;
  };
  while (share.by_order.size() > max_messages_of_one_ || share.bytes > max_bytes_of_one_) erase_one({far, source});
  // Near ones come first among the sources.
  const auto first_far = [&] { return sources_.lower_bound({true, ""}); };
  while (far_.messages > max_messages_of_one_ || far_.bytes > max_bytes_of_one_) {
    erase_one(largest(first_far(), sources_.end(), far_.bytes > max_bytes_of_one_));
  }
  while (held_.size() > max_messages_ || bytes_ > max_bytes_) {
    const auto begin = far_.messages > 0 ? first_far() : sources_.begin();
    erase_one(largest(begin, sources_.end(), bytes_ > max_bytes_));
  }
  return result;
}

LatchStore::Source LatchStore::largest(Shares::const_iterator begin, Shares::const_iterator end, bool by_bytes) {
  return std::max_element(begin, end,
                          [&](const auto& a, const auto& b) {
                            return by_bytes ? a.second.bytes < b.second.bytes
                                            : a.second.by_order.size() < b.second.by_order.size();
                          })
      ->first;
}

LatchStore::Held* LatchStore::find(const std::string& topic, const std::string& key) {
  const auto found = held_.find(Key(topic, key));
  return found == held_.end() ? nullptr : &found->second;
}

void LatchStore::erase(const std::string& topic, const std::string& key) {
  const auto found = held_.find(Key(topic, key));
  if (found == held_.end()) return;
  const auto share = sources_.find({found->second.far, found->second.source});
  const std::size_t bytes = found->second.frames.bytes();
  bytes_ -= bytes;
  share->second.bytes -= bytes;
  if (found->second.far) far_ = {far_.messages - 1, far_.bytes - bytes};
  share->second.by_order.erase(found->second.order);
  if (share->second.by_order.empty()) sources_.erase(share);
  held_.erase(found);
}

void LatchStore::erase_oldest(const Source& source) {
  const Key oldest = sources_.at(source).by_order.begin()->second;
  erase(oldest.first, oldest.second);
}

std::vector<LatchStore::Held> LatchStore::matching(std::string_view prefix) {
  std::vector<Held> result;
  for (auto it = held_.lower_bound(Key(prefix, "")); it != held_.end(); ++it) {
    if (!std::string_view(it->first.first).starts_with(prefix)) break;
    const Held& held = it->second;
    result.push_back({held.order, held.stamp, held.frames.share(), held.source, held.far});
  }
  std::sort(result.begin(), result.end(), [](const Held& a, const Held& b) { return a.order < b.order; });
  return result;
}

}  // namespace splatbus::bus
