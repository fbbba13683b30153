#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <list>
#include <optional>
#include <string>

#include "streamer/bounded_buckets.h"
#include "streamer/endpoint.h"
#include "streamer/peer_limits.h"
#include "streamer/viewer_rate.h"

namespace splatbus::streamer {

/// What is known of those who are no viewers: how often one of them is answered and may become one, whatever others
/// say; and what those who were viewers a moment ago have had already, so that leaving and coming back brings nothing.
/// In bounded memory. One thread.
class PeerBook {
 public:
  /// `of_address`: how many viewers one address may have. All of them come back at once when their streamer has been
  /// restarted.
  explicit PeerBook(std::size_t of_address = kUsual)
      : address_hellos_(crowd(of_address) * kHellos_s, crowd(of_address) * kHellosAtOnce) {}

  static constexpr std::size_t kMaxLeavers = 256;
  static constexpr std::ptrdiff_t kForgiven = 4;
  static constexpr std::int64_t kRememberNs = 10'000'000'000;

  /// Whether a word of somebody unknown is answered.
  [[nodiscard]] bool answers(const Endpoint::Peer& peer, std::int64_t now_ns) {
    return words_.take(peer, 1, now_ns) && all_words_.take(1, now_ns);
  }
  /// Whether its Hello is heard. One connection leaves the others of its address their share, and one address other
  /// addresses theirs.
  [[nodiscard]] bool admits(const Endpoint::Peer& peer, const std::string& address, std::int64_t now_ns) {
    return hellos_.take(peer, 1, now_ns) && (address.empty() || address_hellos_.take(address, 1, now_ns)) &&
           all_hellos_.take(1, now_ns);
  }

  struct Leaver {
    PeerLimits limits;
    ViewerRate::Spent spent;
    std::int64_t posed_ns = 0;
  };
  void left(const Endpoint::Peer& peer, const std::string& address, const std::string& name, Leaver leaver,
            std::int64_t now_ns);
  /// Of a viewer that comes by the same connection, or by another one of its address under its name. Where more than
  /// kForgiven have left an address, whoever comes from there goes on as the last of them did: one who takes a new
  /// each time gains no more than that, and a newcomer among few neighbours owes nothing of theirs.
  [[nodiscard]] std::optional<Leaver> take_leaver(const Endpoint::Peer& peer, const std::string& address,
                                                  const std::string& name, std::int64_t now_ns);

 private:
  struct Entry {
    Endpoint::Peer peer;
    std::string address, name;
    std::int64_t left_ns = 0;
    Leaver leaver;
  };

  static constexpr std::size_t kUsual = 56;  ///< viewers of one address
  static constexpr double kHellos_s = 4, kHellosAtOnce = 40;
  [[nodiscard]] static double crowd(std::size_t of_address) {
    return std::max(1.0, static_cast<double>(of_address) / kUsual);
  }

  BoundedBuckets words_{5, 10}, hellos_{1, 5}, address_hellos_;
  bus::TokenBucket all_words_{200, 200}, all_hellos_{100, 200};
  std::list<Entry> leavers_;  ///< who left first is in front
};

}  // namespace splatbus::streamer
