#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <map>
#include <string>

#include "bus/token_bucket.h"
#include "streamer/bounded_buckets.h"
#include "streamer/endpoint.h"

namespace splatbus::streamer {

/// Those who ask for pages without being viewers, such as a gateway's cache, until they have not asked for a while. How
/// many they are, and how much each and all of them ask for, is bounded. Who is no service of ours may ask too, a
/// little, and is none of them. One thread.
class PageReaders {
 public:
  static constexpr std::size_t kMaxReaders = 16;
  static constexpr double kPages_s = 500, kBurst = 500;                 ///< of one
  static constexpr double kStrangersPages_s = 5, kStrangersBurst = 20;  ///< of one address that is no service's
  static constexpr std::int64_t kForgetNs = 10'000'000'000;

  /// In pages; half a second's worth at most, so that the manifest of a world of any size can be asked for.
  [[nodiscard]] static double price_of_manifest(std::size_t offered) {
    const std::size_t hundreds = offered / 100;
    return std::min(1 + static_cast<double>(hundreds), kBurst / 2);
  }

  /// Whether this peer is given `pages` (or as much of a manifest) now. Who asks for nothing is given nothing.
  [[nodiscard]] bool take(const Endpoint::Peer& peer, double pages, std::int64_t now_ns) {
    if (!(pages > 0) || (!readers_.contains(peer) && readers_.size() >= kMaxReaders)) return false;
    Reader& reader = readers_[peer];
    reader.asked_ns = now_ns;
    return reader.bucket.take(pages, now_ns) && all_.take(pages, now_ns);
  }
  [[nodiscard]] bool take_as_stranger(const std::string& address, double pages, std::int64_t now_ns) {
    return pages > 0 && strangers_.take(address, pages, now_ns) &&
           all_strangers_.take(std::min(pages, kStrangersBurst), now_ns);
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
  bus::TokenBucket all_{2 * kPages_s, 2 * kBurst};  ///< pages are encoded between those that viewers are sent
  BoundedBuckets strangers_{kStrangersPages_s, kStrangersBurst};
  bus::TokenBucket all_strangers_{50, 100};
};

}  // namespace splatbus::streamer
