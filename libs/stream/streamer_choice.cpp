#include "stream/streamer_choice.h"

#include <algorithm>
#include <chrono>
#include <tuple>
#include <utility>

#include "bus/frames.h"
#include "wire/stream_generated.h"
#include "wire/system_generated.h"
#include "wire/topics.h"

namespace splatbus::stream {

namespace {

constexpr std::size_t kMaxStreamers = 64, kMaxEndpoint = 256;
constexpr std::int64_t kUncountedNs = 2'000'000'000;
constexpr std::int64_t kBusGapNs = 3'000'000'000;
constexpr double kFull = 0.8;  // of a tick: beyond it the next tick waits
constexpr std::size_t kWorthAMove = 4;

std::string reachable(const wire::StreamerOffer& offer, bool local) {
  std::string by_tcp;
  for (const auto* endpoint : *offer.endpoints()) {
    const std::string_view text = endpoint->string_view();
    if (text.size() > kMaxEndpoint || bus::printable(text, kMaxEndpoint) != text) continue;
    if (local && text.starts_with("ipc://")) return std::string(text);
    if (text.starts_with("tcp://") && by_tcp.empty()) by_tcp = text;
  }
  return by_tcp;
}

}  // namespace

void StreamerChoice::take(const wire::StreamerOffer& body, std::int64_t now_ns) {
  const std::string source = body.header()->source()->str();
  const std::string endpoint = reachable(body, local_);
  if (endpoint.empty() || (!offers_.contains(source) && offers_.size() >= kMaxStreamers)) return;
  Offer& offer = offers_[source];
  offer.endpoint = endpoint;
  offer.viewers = body.viewers();
  offer.max_viewers = body.max_viewers();
  offer.busy = body.tick_ms() > 0 ? (body.encode_ms() + body.send_ms()) / body.tick_ms() : 0;
  offer.draining = body.draining();
  offer.alive = true;
  offer.heard_ns = now_ns;
}

void StreamerChoice::take(const wire::Liveness& liveness, std::int64_t now_ns) {
  // What streamers said while the bus was away is on its way yet.
  if (now_ns - liveness_ns_ > kBusGapNs) {
    for (auto& [source, offer] : offers_) offer.heard_ns = now_ns;
  }
  liveness_ns_ = now_ns;
  std::erase_if(offers_, [&](const auto& entry) { return now_ns - entry.second.heard_ns > 12 * kStaleNs; });
  if (liveness.nodes() == nullptr) return;
  for (const auto* node : *liveness.nodes()) {
    // Of a source that a broker has only just heard of, or not yet, it says nothing.
    if (const auto found = offers_.find(node->source()->str()); found != offers_.end()) {
      found->second.alive = node->alive();
    }
  }
}

bool StreamerChoice::serves(const Offer& offer) const {
  const bool is_passed_over =
      offer.endpoint == offer.passed_over && liveness_ns_ - offer.passed_over_ns <= kPassedOverNs;
  return offer.alive && !offer.draining && !is_passed_over && liveness_ns_ - offer.heard_ns <= kStaleNs;
}

bool StreamerChoice::serves(const StreamerPlace& place) const {
  const auto found = offers_.find(place.source);
  return found != offers_.end() && found->second.endpoint == place.endpoint && serves(found->second);
}

bool StreamerChoice::pass_over(const StreamerPlace& place, std::int64_t now_ns) {
  const auto found = offers_.find(place.source);
  if (found == offers_.end() || found->second.endpoint != place.endpoint) return true;
  found->second.passed_over_ns = now_ns;
  return std::exchange(found->second.passed_over, place.endpoint) != place.endpoint;
}

bool StreamerChoice::others_serve(const std::string& source) const {
  return std::ranges::any_of(offers_, [&](const auto& entry) { return entry.first != source && serves(entry.second); });
}

std::size_t StreamerChoice::serving() const {
  return static_cast<std::size_t>(
      std::ranges::count_if(offers_, [&](const auto& entry) { return serves(entry.second); }));
}

StreamerChoice::Offers::iterator StreamerChoice::least_loaded(std::int64_t now_ns) {
  for (auto& [source, offer] : offers_) {
    std::erase_if(offer.sent_ns, [&](std::int64_t sent) { return now_ns - sent > kUncountedNs; });
  }
  const auto load = [](const Offer& offer) {
    const std::size_t viewers = offer.viewers + offer.sent_ns.size();
    const bool full = viewers >= offer.max_viewers;
    return std::tuple(full, offer.busy > kFull, viewers, offer.busy);
  };
  auto least = offers_.end();
  for (auto at = offers_.begin(); at != offers_.end(); ++at) {
    if (serves(at->second) && (least == offers_.end() || load(at->second) < load(least->second))) least = at;
  }
  return least;
}

std::optional<StreamerPlace> StreamerChoice::choose(std::int64_t now_ns) {
  const auto least = least_loaded(now_ns);
  if (least == offers_.end()) return std::nullopt;
  least->second.sent_ns.push_back(now_ns);
  return StreamerPlace{least->first, least->second.endpoint};
}

std::optional<StreamerPlace> StreamerChoice::better_than(const StreamerPlace& place, std::int64_t now_ns) {
  if (!serves(place)) return choose(now_ns);
  const auto least = least_loaded(now_ns);
  const Offer& own = offers_.at(place.source);
  const std::size_t there = least->second.viewers + least->second.sent_ns.size();
  if (least->first == place.source || own.viewers < there + std::max(kWorthAMove, own.viewers / 4)) {
    return std::nullopt;
  }
  least->second.sent_ns.push_back(now_ns);
  return StreamerPlace{least->first, least->second.endpoint};
}

void follow_offers(bus::Subscriber& subscriber, StreamerChoice& choice, const std::int64_t& now_ns) {
  subscriber
      .on(topics::kStreamerOffer,
          [&choice, &now_ns](const wire::StreamerOffer& body, const bus::Message&) { choice.take(body, now_ns); })
      .on(topics::kLiveness,
          [&choice, &now_ns](const wire::Liveness& body, const bus::Message&) { choice.take(body, now_ns); });
}

StreamerFinder::StreamerFinder(const std::shared_ptr<bus::Context>& context)
    : subscriber_(context), choice_(context->address().is_local()) {
  follow_offers(subscriber_, choice_, now_ns_);
}

const std::string& StreamerFinder::endpoint(std::int64_t now_ns) {
  now_ns_ = now_ns;
  subscriber_.dispatch_all(std::chrono::milliseconds(0));
  if (!choice_.serves(place_)) {
    if (const auto other = choice_.choose(now_ns)) place_ = *other;
  }
  return place_.endpoint;
}

}  // namespace splatbus::stream
