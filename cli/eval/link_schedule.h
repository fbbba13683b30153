#pragma once

#include <cstddef>
#include <cstdint>
#include <random>
#include <string>

namespace splatbus::cli {

/// What a link does to what passes it, the same both ways.
struct LinkShape {
  double round_trip_ms = 0;  ///< half of it each way
  double mbps = 0;           ///< 1e6 bit a second each way; 0: no limit
  double loss = 0;           ///< share of the segments, each way, [0, 1)

  [[nodiscard]] bool empty() const { return round_trip_ms == 0 && mbps == 0 && loss == 0; }
  [[nodiscard]] std::string text() const;  ///< "5 Mbit/s, 100 ms round trip, 2 % loss"
};

/// While nothing passes, CLOCK_MONOTONIC ns: [from, to).
struct LinkCut {
  std::int64_t from_ns = 0, to_ns = 0;
  [[nodiscard]] bool contains(std::int64_t at_ns) const { return at_ns >= from_ns && at_ns < to_ns; }
};

/// When what was sent at `first_ns` and again after `timeout_ns`, then after twice that, and so on, is sent outside of
/// the cut: as Linux's tcp repeats what nobody acknowledges.
[[nodiscard]] std::int64_t repeated_until_passed(std::int64_t first_ns, std::int64_t timeout_ns, const LinkCut& cut);

/// One way of one tcp connection over a link, as arithmetic on times that the caller gives: a line of a rate, behind it
/// the way. A segment that is lost comes a round trip later (what was sent again and lost again: a timeout later), and
/// what was sent after it waits for it, since tcp keeps the order. In a cut nothing leaves until a repetition passes.
/// It has no congestion window: of a lossy link with a long way real tcp may make less.
class LinkSchedule {
 public:
  static constexpr std::size_t kSegmentBytes = 1448;
  static constexpr std::int64_t kQueueNs = 250'000'000;              ///< of the line, before the sender has to wait
  static constexpr std::size_t kWindowBytes = std::size_t{1} << 18;  ///< on the way, likewise
  static constexpr std::int64_t kTimeoutNs = 200'000'000;            ///< beyond the round trip

  explicit LinkSchedule(const LinkShape& shape, std::uint64_t seed = 0) : shape_(shape), random_(seed) {}

  /// Announced before it begins: at least kQueueNs where the link has a rate.
  void cut(const LinkCut& cut) { cut_ = cut; }

  /// Bytes, at most a segment, that the sender has for the link at `now_ns`, which never runs backwards: when they
  /// are at the other end, never before what was sent earlier.
  [[nodiscard]] std::int64_t send(std::size_t bytes, std::int64_t now_ns);

  /// Whether the sender has to wait: `on_the_way` bytes have been sent and are not at the other end.
  [[nodiscard]] bool full(std::size_t on_the_way, std::int64_t now_ns) const {
    return line_free_ns_ - now_ns > kQueueNs || on_the_way >= kWindowBytes;
  }

 private:
  [[nodiscard]] std::int64_t round_trip_ns() const { return static_cast<std::int64_t>(shape_.round_trip_ms * 1e6); }
  [[nodiscard]] bool lost() { return shape_.loss > 0 && std::bernoulli_distribution(shape_.loss)(random_); }

  LinkShape shape_;
  LinkCut cut_;
  std::mt19937_64 random_;
  std::int64_t line_free_ns_ = 0, last_ns_ = 0;
};

}  // namespace splatbus::cli
