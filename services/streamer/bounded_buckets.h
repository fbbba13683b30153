#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <map>
#include <string>

#include "bus/token_bucket.h"

namespace splatbus::streamer {

/// A bucket for each of those who come, in bounded memory: whoever has been away for longest is forgotten first. One
/// thread.
class BoundedBuckets {
 public:
  static constexpr std::size_t kMax = 1024;

  BoundedBuckets(double rate_per_second, double burst) : rate_(rate_per_second), burst_(burst) {}

  [[nodiscard]] bool take(const std::string& whose, double amount, std::int64_t now_ns) {
    auto found = entries_.find(whose);
    if (found == entries_.end()) {
      if (entries_.size() >= kMax) forget_some(now_ns);
      found = entries_.emplace(whose, Entry{bus::TokenBucket(rate_, burst_), now_ns}).first;
    }
    found->second.used_ns = now_ns;
    return found->second.bucket.take(std::min(amount, burst_), now_ns);
  }
  [[nodiscard]] std::size_t size() const { return entries_.size(); }

 private:
  struct Entry {
    bus::TokenBucket bucket;
    std::int64_t used_ns = 0;
  };
  void forget_some(std::int64_t now_ns) {
    // By then a bucket is full again, as a new one is.
    const auto full_ns = static_cast<std::int64_t>(burst_ / rate_ * 1e9);
    std::erase_if(entries_, [&](const auto& entry) { return now_ns - entry.second.used_ns > full_ns; });
    if (entries_.size() < kMax) return;
    entries_.erase(std::ranges::min_element(entries_, {}, [](const auto& entry) { return entry.second.used_ns; }));
  }

  double rate_, burst_;
  std::map<std::string, Entry> entries_;
};

}  // namespace splatbus::streamer
