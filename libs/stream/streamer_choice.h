#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "bus/subscriber.h"

namespace splatbus::wire {
struct Liveness;
struct StreamerOffer;
}  // namespace splatbus::wire

namespace splatbus::stream {

/// A streamer, and where viewers connect to it.
struct StreamerPlace {
  std::string source, endpoint;
  bool operator==(const StreamerPlace&) const = default;
};

/// What streamers say of themselves (stream/offer), and the broker of them (sys/liveness): which one takes the next
/// viewer. Streamers of equal load take turns; one whose CPU time fills its ticks comes after all that have some left.
/// While the bus is silent nobody is taken for gone. Times are CLOCK_MONOTONIC. One thread.
class StreamerChoice {
 public:
  /// `local`: ipc endpoints are within reach; else those over tcp alone.
  explicit StreamerChoice(bool local) : local_(local) {}

  void take(const wire::StreamerOffer& offer, std::int64_t now_ns);
  void take(const wire::Liveness& liveness, std::int64_t now_ns);

  /// Whether that streamer is there, takes viewers, and is where the place says.
  [[nodiscard]] bool serves(const StreamerPlace& place) const;
  /// The least loaded; nullopt when none serves. It counts as having the viewer until its next offers say so
  /// themselves.
  [[nodiscard]] std::optional<StreamerPlace> choose(std::int64_t now_ns);
  /// Where a viewer of `place` should go: while that one serves, to one that has far fewer viewers, if there is one;
  /// else as choose(). Nullopt: it stays.
  [[nodiscard]] std::optional<StreamerPlace> better_than(const StreamerPlace& place, std::int64_t now_ns);
  /// A viewer could not connect to it: nobody is sent there for kPassedOverNs, or until it offers another place. True
  /// when that was not known.
  bool pass_over(const StreamerPlace& place, std::int64_t now_ns);
  /// Whether any streamer but `source` takes viewers.
  [[nodiscard]] bool others_serve(const std::string& source) const;
  [[nodiscard]] std::size_t serving() const;

  /// An offer that is older than the newest word of the broker by so much counts no more.
  static constexpr std::int64_t kStaleNs = 5'000'000'000;
  static constexpr std::int64_t kPassedOverNs = 10'000'000'000;

 private:
  struct Offer {
    std::string endpoint;
    std::size_t viewers = 0, max_viewers = 0;
    double busy = 0;  ///< share of a tick that its CPU time takes
    bool draining = false, alive = true;
    std::int64_t heard_ns = 0;
    std::string passed_over{};  ///< an endpoint
    std::int64_t passed_over_ns = 0;
    std::deque<std::int64_t> sent_ns;  ///< when viewers were sent there, that its offers may not count yet
  };
  using Offers = std::map<std::string, Offer>;
  [[nodiscard]] bool serves(const Offer& offer) const;
  [[nodiscard]] Offers::iterator least_loaded(std::int64_t now_ns);

  bool local_;
  std::int64_t liveness_ns_ = 0;
  Offers offers_;
};

/// The streamer of one viewer, by what the bus says. One thread.
class StreamerFinder {
 public:
  explicit StreamerFinder(const std::shared_ptr<bus::Context>& context);

  /// The endpoint of a streamer that serves: the same one for as long as it does. When none does it is the last one,
  /// which may come back; empty before there was any. Never waits.
  [[nodiscard]] const std::string& endpoint(std::int64_t now_ns);

 private:
  bus::Subscriber subscriber_;
  StreamerChoice choice_;
  std::int64_t now_ns_ = 0;
  StreamerPlace place_;
};

/// The handlers that keep a StreamerChoice; `choice` and `now_ns`, which says when, outlive the subscriber.
void follow_offers(bus::Subscriber& subscriber, StreamerChoice& choice, const std::int64_t& now_ns);

}  // namespace splatbus::stream
