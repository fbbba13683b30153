#pragma once

#include <cstddef>
#include <cstdint>
#include <map>

#include "bus/token_bucket.h"
#include "streamer/endpoint.h"

namespace splatbus::streamer {

/// Those who ask for pages without being viewers, such as a gateway's cache, until they have not asked for a while. How
/// many they are, and how much each asks for, is bounded. One thread.
class PageReaders {
 public:
  static constexpr std::size_t kMaxReaders = 16;
  static constexpr double kPages_s = 500, kBurst = 500;  ///< of one
  static constexpr std::int64_t kForgetNs = 10'000'000'000;

  /// Whether this peer is given `pages` (or as much of a manifest) now.
  [[nodiscard]] bool take(const Endpoint::Peer& peer, double pages, std::int64_t now_ns) {
    if (!readers_.contains(peer) && readers_.size() >= kMaxReaders) return false;
    Reader& reader = readers_[peer];
    reader.asked_ns = now_ns;
    return reader.bucket.take(pages, now_ns);
  }
  /// Forgets those that ask no more; true when that were the last.
  [[nodiscard]] bool expire(std::int64_t now_ns) {
    const auto gone =
        std::erase_if(readers_, [&](const auto& entry) { return now_ns - entry.second.asked_ns > kForgetNs; });
    return gone > 0 && readers_.empty();
  }
  [[nodiscard]] bool empty() const { return readers_.empty(); }

 private:
  struct Reader {
    bus::TokenBucket bucket{kPages_s, kBurst};
    std::int64_t asked_ns = 0;
  };
  std::map<Endpoint::Peer, Reader> readers_;
};

}  // namespace splatbus::streamer
