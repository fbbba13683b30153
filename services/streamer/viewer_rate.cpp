#include "streamer/viewer_rate.h"

#include <optional>
#include <utility>

namespace splatbus::streamer {

namespace {

constexpr std::int64_t kRememberRateNs = 2'500'000'000, kRememberWayNs = 1'000'000'000;
constexpr std::int64_t kRememberLeastWayNs = 10'000'000'000;  // once or twice: routes change
constexpr std::int64_t kSilenceNs = 1'000'000'000;
constexpr std::size_t kRememberSamples = 6;  // at least: an outage is one, and says nothing of the rate after it
constexpr std::int64_t kLeastSampleNs = 10'000'000;
// Viewers say what has come at least four times a second; a moment is for the sending itself.
constexpr double kLeastSaid_s = 0.05, kMostSaid_s = 0.25, kMoment_s = 0.15;
constexpr double kLeastWindow = 16 * 1024;
constexpr double kLongQueue_s = 0.4;  // then what was delivered before says nothing
constexpr std::size_t kWaysOfAQueue = 3, kSamplesOfAQueue = 2;
constexpr double kShortQueue_s = 0.1, kQueue_s = 0.2;  // beyond the empty way
constexpr std::int64_t kQueueNs = 200'000'000;
constexpr double kGrow = 1.25, kShrink = 0.8;
constexpr double kMostOfRate = 1.25;  // that the link is remembered to take
// Of a second at the rate: a Keepalive, of which each has one. What is larger than a second would wait for ever.
constexpr double kBeside = 0.02;

}  // namespace

void ViewerRate::begin_with(Spent spent) {
  bucket_ = spent.bucket;
  debt_ = spent.debt;
  second_ = std::move(spent.second);
  goes_on_ = true;
}

void ViewerRate::set(double kbps, double most_kbps, std::int64_t now_ns) {
  if (kbps > 0) kbps = std::max(kbps, kLeastKbps);
  if (kbps == kbps_ && most_kbps == most_kbps_) return;
  const bool first = kbps_ < 0, other = kbps != kbps_;
  const bool less = kbps > 0 && (kbps_ == 0 || kbps < kbps_);
  kbps_ = kbps;
  most_kbps_ = most_kbps;
  const double wanted = most_kbps > 0 ? std::clamp(most_kbps * 125, kLeast, kMost) : kMost;
  most_ = kbps > 0 ? std::min(kbps * 125, wanted) : wanted;
  if (less) {  // what the link takes has been found
    link_ = std::min(link_, kbps * 125);
  } else if (other) {
    link_ = kbps > 0 ? kbps * 125 : kFirst;
    samples_.clear();
  }
  if (first && !goes_on_) bucket_ = bus::TokenBucket(bytes_per_s(), burst());
  refill(now_ns);
}

void ViewerRate::refill(std::int64_t now_ns) {
  const double queued = queued_s();
  const double gain = queued < kShortQueue_s ? kGrow : queued < kQueue_s ? 1 : kShrink;
  bucket_.set(std::min(most_, gain * link_), burst(), now_ns);
}

double ViewerRate::queued_s() const {
  if (ways_.empty()) return 0;
  const std::int64_t lately_ns = std::ranges::min_element(ways_, {}, &Way::ns)->ns;
  return static_cast<double>(lately_ns - least_way_ns()) * 1e-9;
}

double ViewerRate::wanted_window() const {
  const double way_s = ways_.empty() ? 0 : static_cast<double>(least_way_ns()) * 1e-9;
  return std::max(bytes_per_s() * (way_s + said_s_ + kMoment_s), kLeastWindow);
}

double ViewerRate::window() const {
  return std::min(wanted_window(), kFirstWindow + delivered_);
}

double ViewerRate::available(std::int64_t now_ns) {
  if (debt_ > 0) {
    const double paid = std::min(debt_, bucket_.available(now_ns));
    if (bucket_.take(paid, now_ns)) debt_ -= paid;
  }
  return debt_ > 0 ? 0 : bucket_.available(now_ns);
}

bool ViewerRate::second_has_room(double bytes, double share, std::int64_t now_ns) {
  const double there = second_.amount(now_ns);
  return there <= kBeside || there + bytes / most_ <= share;
}

bool ViewerRate::has_room(double bytes, std::int64_t now_ns) {
  forget_unacknowledged(now_ns);
  const bool room = packets_.empty() || on_the_way_ + bytes <= window();
  held_up_ = held_up_ || !room;
  return room;
}

void ViewerRate::forget_unacknowledged(std::int64_t now_ns) {
  const std::int64_t from_ns = std::max(acknowledged_ns_ + kSilenceNs, forgot_ns_);
  if (packets_.empty() || now_ns <= from_ns) return;
  forgot_ns_ = now_ns;
  forgettable_ += kSilentBytes_s * static_cast<double>(now_ns - from_ns) * 1e-9;
  while (!packets_.empty() && packets_.front().bytes <= forgettable_) {
    forgettable_ -= packets_.front().bytes;
    on_the_way_ -= packets_.front().bytes;
    packets_.pop_front();
  }
  if (packets_.empty()) on_the_way_ = forgettable_ = 0;
}

void ViewerRate::take(std::uint64_t sequence, double bytes, std::int64_t now_ns) {
  if (acknowledged_ == last_sequence_) acknowledged_ns_ = now_ns;
  const double tokens = bucket_.available(now_ns);
  const bool idle = std::exchange(idle_, false);
  if (!std::exchange(held_up_, false) && tokens > 0.999 * burst()) {
    rested_ = true;
    rested_until_ = last_sequence_;
    // A full bucket though there was something to send: this process was late, and not the link.
    late_ = late_ || !idle;
    if (!idle) late_until_ = last_sequence_;
  }
  packets_.push_back({.sequence = sequence,
                      .bytes = bytes,
                      .sent_ns = now_ns,
                      .acknowledged_ns = acknowledged_ns_,
                      .delivered = delivered_,
                      .ahead = on_the_way_,
                      .rested = rested_ || starts(),
                      .late = late_});
  on_the_way_ += bytes;
  second_.add(bytes / most_, now_ns);
  last_sequence_ = sequence;
  const double there = std::min(bytes, tokens);
  if (bucket_.take(there, now_ns)) debt_ += bytes - there;
}

void ViewerRate::rest() {
  rested_ = idle_ = true;
  rested_until_ = last_sequence_;
}

void ViewerRate::acknowledged(std::uint64_t newest, std::int64_t now_ns) {
  if (newest <= acknowledged_) return;
  acknowledged_ = newest;
  std::optional<Packet> last;
  while (!packets_.empty() && packets_.front().sequence <= newest) {
    last = packets_.front();
    packets_.pop_front();
    on_the_way_ -= last->bytes;
    delivered_ += last->bytes;
  }
  if (packets_.empty()) on_the_way_ = 0;
  forgettable_ = 0;
  if (last) {
    learn_way(*last, now_ns);
    learn_rate(*last, now_ns);
  }
  const double since_s = static_cast<double>(now_ns - acknowledged_ns_) * 1e-9;
  said_s_ += 0.25 * (std::clamp(since_s, kLeastSaid_s, kMostSaid_s) - said_s_);
  acknowledged_ns_ = now_ns;
  if (newest > rested_until_) rested_ = false;
  if (newest > late_until_) late_ = false;
  refill(now_ns);
}

std::optional<std::int64_t> ViewerRate::owes_since_ns() const {
  if (acknowledged_ == 0 || acknowledged_ == last_sequence_) return std::nullopt;
  return acknowledged_ns_;
}

void ViewerRate::learn_way(const Packet& packet, std::int64_t now_ns) {
  const std::int64_t way_ns = std::max<std::int64_t>(now_ns - packet.sent_ns, 1);
  if (now_ns - least_way_since_ns_ > kRememberLeastWayNs) {
    least_way_since_ns_ = now_ns;
    least_way_before_ns_ = std::exchange(least_way_now_ns_, kNever);
  }
  least_way_now_ns_ = std::min(least_way_now_ns_, way_ns);
  ways_.push_back({now_ns, way_ns});
  while (now_ns - ways_.front().at_ns > kRememberWayNs) ways_.pop_front();
  const std::int64_t waits_ns = way_ns - least_way_ns();
  queued_ = queued_ || (waits_ns > kQueueNs && waited_ns_ > kQueueNs);
  waited_ns_ = waits_ns;
}

void ViewerRate::learn_rate(const Packet& packet, std::int64_t now_ns) {
  const std::int64_t over_ns = now_ns - packet.acknowledged_ns;
  if (over_ns < kLeastSampleNs) return;
  const double sample = (delivered_ - packet.delivered) / (static_cast<double>(over_ns) * 1e-9);
  const bool queues = ways_.size() >= kWaysOfAQueue && queued_s() > kLongQueue_s;
  // A queue of what was sent is the link's, also where nothing more waited here.
  const bool waits = queues && !packet.late && packet.ahead > kLeastWindow;
  if (packet.rested && sample <= link_ && !waits) return;
  samples_.push_back({now_ns, sample});
  while ((samples_.size() > kRememberSamples && now_ns - samples_.front().at_ns > kRememberRateNs) ||
         (samples_.size() > kSamplesOfAQueue && queues)) {
    samples_.pop_front();
  }
  const double largest = std::ranges::max_element(samples_, {}, &Sample::bytes_per_s)->bytes_per_s;
  link_ = std::min(std::max(largest, kLeastLink), kMostOfRate * most_);
}

}  // namespace splatbus::streamer
