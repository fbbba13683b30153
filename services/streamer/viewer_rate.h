#pragma once

#include <algorithm>
#include <cstdint>
#include <deque>
#include <limits>
#include <optional>

#include "bus/token_bucket.h"
#include "streamer/last_second.h"

namespace splatbus::streamer {

/// When and how fast one viewer is sent bytes: no second has more than 1.1 times the rate, unless one packet alone is
/// larger than that and goes with no more than a Keepalive; and no more is on the way than its link delivers until the
/// viewer can have said so. Queues on the way stay short whatever the link does, and what is not sent yet can still be
/// replaced by something newer.
///
/// What the link takes is found as BBR does (Cardwell et al. 2016): the largest rate at which packets that were sent
/// without a pause were acknowledged lately, while the least time from packet to acknowledgement says how long an empty
/// way is. It grows while that time stays near its least, and shrinks to what is delivered when it does not.
///
/// Who acknowledges nothing, for a while or ever, is sent kSilentBytes_s beyond the window: it never stops, and a link
/// that is cut holds little that is old.
class ViewerRate {
 public:
  /// kbps 0: whatever the link takes. `most_kbps`: what the viewer wants at most; 0: it does not mind. Below
  /// kLeastKbps either is taken for that.
  void set(double kbps, double most_kbps, std::int64_t now_ns);
  /// The packet of that number, which only grows, was sent. What is larger than the burst goes when that is there, and
  /// is paid for later.
  void take(std::uint64_t sequence, double bytes, std::int64_t now_ns);
  /// There was nothing more to send: what is delivered until then says nothing of what the link takes, unless much of
  /// it waits on the way.
  void rest();
  /// The packets up to `newest` have come, or never will.
  void acknowledged(std::uint64_t newest, std::int64_t now_ns);

  /// Bytes that the rate allows for at this moment.
  [[nodiscard]] double available(std::int64_t now_ns);
  /// Whether so many more may go in this second: the bucket alone would let what is larger than it pass in one.
  /// `share`: of the rate, that one second may have.
  [[nodiscard]] bool second_has_room(double bytes, double share, std::int64_t now_ns);
  /// Whether so many more may be on the way.
  [[nodiscard]] bool has_room(double bytes, std::int64_t now_ns);
  /// Of a viewer that does acknowledge: since when it owes that; nullopt while it does not.
  [[nodiscard]] std::optional<std::int64_t> owes_since_ns() const;
  /// What is allowed, and what the link takes.
  [[nodiscard]] double bytes_per_s() const { return std::min(most_, link_); }
  /// What may go at once; window() bounds it on a link that takes less than is allowed.
  [[nodiscard]] double burst() const {
    return std::max(kBurst_s * std::min(most_, std::max(link_, kFirst)), kLeastBurst);
  }
  /// What the link takes in as long: a packet should have less.
  [[nodiscard]] double large() const { return std::max(kBurst_s * bytes_per_s(), kLeastBurst); }
  /// What may be on the way.
  [[nodiscard]] double window() const;
  [[nodiscard]] double on_the_way() const { return on_the_way_; }

  static constexpr double kFirstWindow =
      128 * 1024;  ///< bytes; what is acknowledged adds as much: it doubles each round trip
  static constexpr double kSilentBytes_s = 8 * 1024;
  static constexpr double kLeastKbps = 100;

  /// What has been taken of the rate.
  struct Spent {
    bus::TokenBucket bucket{1, 1};
    double debt = 0;
    LastSecond second;
  };
  [[nodiscard]] Spent spent() const { return {bucket_, debt_, second_}; }
  /// Before the first set(): another one of the same viewer has spent that.
  void begin_with(Spent spent);

 private:
  static constexpr double kBurst_s = 0.1, kLeastBurst = 8192;
  static constexpr std::int64_t kNever = std::numeric_limits<std::int64_t>::max();
  static constexpr double kLeast = 125 * kLeastKbps, kFirst = 1.25e6, kLeastLink = 1e4,
                          kMost = 1.25e8;  // bytes a second
  struct Packet {
    std::uint64_t sequence = 0;
    double bytes = 0;
    std::int64_t sent_ns = 0, acknowledged_ns = 0;  ///< the latter: the last packet when this one was sent
    double delivered = 0, ahead = 0;                ///< bytes, when it was sent: in all, and on the way then
    bool rested = false, late = false;              ///< this process had paused, having nothing to send or otherwise
  };
  struct Sample {
    std::int64_t at_ns = 0;
    double bytes_per_s = 0;
  };
  struct Way {
    std::int64_t at_ns = 0, ns = 0;
  };
  void refill(std::int64_t now_ns);
  void forget_unacknowledged(std::int64_t now_ns);
  void learn_way(const Packet& packet, std::int64_t now_ns);
  void learn_rate(const Packet& packet, std::int64_t now_ns);
  [[nodiscard]] std::int64_t least_way_ns() const { return std::min(least_way_before_ns_, least_way_now_ns_); }
  [[nodiscard]] double queued_s() const;
  [[nodiscard]] double wanted_window() const;
  [[nodiscard]] bool starts() const { return !queued_ && kFirstWindow + delivered_ < wanted_window(); }

  double kbps_ = -1, most_kbps_ = 0, most_ = kMost, link_ = 0, debt_ = 0;
  bus::TokenBucket bucket_{1, 1};
  LastSecond second_;     ///< of what it may have: bytes over the rate at which they went
  bool goes_on_ = false;  ///< begin_with()

  std::deque<Packet> packets_;  ///< that are on the way
  double on_the_way_ = 0, delivered_ = 0;
  double said_s_ = 0.25;                              ///< from one acknowledgement to the next
  std::int64_t acknowledged_ns_ = 0, forgot_ns_ = 0;  ///< the former: or when there was something to acknowledge
  double forgettable_ = 0;                            ///< bytes, of the packet that was on the way for longest
  std::int64_t waited_ns_ = 0;                        ///< the packet that was acknowledged last, beyond the least way
  std::int64_t least_way_before_ns_ = kNever, least_way_now_ns_ = kNever, least_way_since_ns_ = 0;
  std::uint64_t last_sequence_ = 0, acknowledged_ = 0, rested_until_ = 0, late_until_ = 0;
  bool rested_ = true, late_ = false, held_up_ = false;  ///< the last: by the window
  bool idle_ = true;                                     ///< rest() was the last that was heard
  bool queued_ = false;                                  ///< packets have waited on the way, once
  std::deque<Sample> samples_;                           ///< of the last seconds
  std::deque<Way> ways_;                                 ///< of the last second
};

}  // namespace splatbus::streamer
