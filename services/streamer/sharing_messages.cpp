// What replicas say to each other.

#include <algorithm>
#include <utility>

#include "streamer/sharing.h"
#include "wire/share_topics.h"

namespace splatbus::streamer {

namespace {

constexpr std::int64_t kSayAgainNs = 1'000'000'000;
constexpr std::size_t kMessageBytes = std::size_t{4} << 20;  // of answers, about

}  // namespace

bool Sharing::publishes() const {
  return !peers_.empty() || others_.others_serve(own_);
}

void Sharing::publish(const ShareMessage& message) const {
  publisher_.publish(topics::kStreamShare,
                     [&](auto& builder, auto header) { return write_share(builder, header, message); });
}

void Sharing::take(const wire::StreamShare& body, std::int64_t now_ns) {
  const std::string source = body.header()->source()->str();
  if (source == own_ || (!peers_.contains(source) && peers_.size() >= kMaxPeers)) return;
  ShareMessage message = read_share(body);
  Peer& peer = heard(source, body.header()->epoch());
  leave_out_before(peer, message);
  peer.heard_ns = now_ns;
  if (peer.place.epoch != message.place.epoch) {
    inherit_pages(peer);
    peer.pages.clear();
    peer.told = false;
  }
  peer.place = message.place;
  if (message.viewers) peer.viewers = std::move(*message.viewers);
  if (message.pages) {
    peer.pages = std::move(*message.pages);
    peer.told = true;
  }
  if (!in_stream(peer)) return;
  newest_ = std::max(newest_, peer.place.version);
  take_deltas(std::move(message.deltas), now_ns);
  if (message.viewers) {
    peer.ticked = true;
    contribute(now_ns);
  }
  if (!message.visibility.empty()) hub_.add_others_visibility(std::move(message.visibility), scene_);
  for (ShareAnswer& answer : message.answers) hub_.take(std::move(answer));
  answer(peer, message.wants, now_ns);
}

Sharing::Peer& Sharing::heard(const std::string& source, std::uint64_t incarnation) {
  Peer& peer = peers_[source];
  if (known_.size() < kMaxPeers) known_.insert(source);
  if (peer.incarnation == incarnation) return peer;
  const ShareMessage::Place before = peer.place.epoch != 0 ? peer.place : peer.before;
  const std::int64_t heard_ns = peer.heard_ns;
  inherit_pages(peer);
  peer = {};
  peer.incarnation = incarnation;
  peer.before = before;
  peer.heard_ns = heard_ns;
  return peer;
}

// What it offers at a version that the one before it may have used may be other Gaussians under that one's name. While
// it does it has no share: it sees others encode those pages, and begins them anew above that.
void Sharing::leave_out_before(Peer& peer, ShareMessage& message) {
  const std::uint32_t before = same_stream(message.place, peer.before) ? peer.before.version : 0;
  const auto is_before = [&](const auto& offered) { return offered.version <= before; };
  if (message.pages) peer.reuses = std::erase_if(*message.pages, is_before) > 0;
  message.place.encodes = message.place.encodes && !peer.reuses;
  for (stream::DeltaPacket& delta : message.deltas) std::erase_if(delta.steps, is_before);
}

// Of pages that are encoded here nobody else says anything: no viewer is sent a packet for that.
void Sharing::take_deltas(std::vector<stream::DeltaPacket> deltas, std::int64_t now_ns) {
  const auto own = model_.offered();
  const auto is_own = [&](std::uint32_t page) {
    return division_.owner_of(page) == own_ && std::ranges::binary_search(*own, page, {}, &stream::OfferedPage::page);
  };
  for (stream::DeltaPacket& delta : deltas) {
    std::erase_if(delta.steps, [&](const auto& step) { return is_own(step.page) || is_own(step.base); });
    std::erase_if(delta.gone, [&](const stream::PageVersion& page) { return is_own(page.page); });
    if (delta.steps.empty() && delta.gone.empty()) continue;
    pending_.deltas.push_back(std::move(delta));
    contribute(now_ns);
  }
}

void Sharing::answer(Peer& peer, const std::vector<ShareWant>& wants, std::int64_t now_ns) {
  ShareMessage message;
  std::size_t bytes = 0;
  const auto send = [&] {
    if (message.answers.empty()) return;
    message.place = place();
    publish(message);
    message.answers.clear();
    bytes = 0;
  };
  for (const ShareWant& want : wants) {
    if (!peer.answers.take(1, now_ns)) break;  // it asks again
    std::optional<ShareAnswer> answer = hub_.answer(want);
    if (!answer) continue;
    if (want.part != wire::SharePart::Visibility) given_ns_[want.page] = now_ns;
    bytes += answer_bytes(*answer);
    message.answers.push_back(std::move(*answer));
    if (bytes > kMessageBytes) send();
  }
  send();
}

void Sharing::contribute(std::int64_t now_ns) {
  if (!pending_since_ns_) pending_since_ns_ = now_ns;
}

void Sharing::end_tick(stream::StreamUpdate update, std::int64_t now_ns) {
  place_ = place();
  ticked_ = true;
  // Another heir may only have heard of it as long ago as one is silent before it is gone.
  std::erase_if(inherited_, [&](const auto& entry) {
    const auto& [number, inherited] = entry;
    return inherited.tick_ns && (division_.owner_of(number) == own_ || now_ns - *inherited.tick_ns > kSilentNs);
  });
  contribute(now_ns);
  if (publishes()) publish_tick(update.deltas, now_ns);
  std::ranges::move(update.deltas, std::back_inserter(pending_.deltas));
  pending_.gone.insert(pending_.gone.end(), update.gone.begin(), update.gone.end());
}

void Sharing::restart(std::int64_t now_ns) {
  const std::uint64_t epoch = model_.status().epoch;
  if (epoch != std::exchange(newest_of_, epoch)) newest_ = 0;
  place_ = place();
  for (const auto& [source, peer] : peers_) {
    if (in_stream(peer)) newest_ = std::max(newest_, peer.place.version);
  }
  place_ = place();
  pending_ = {};
  pending_since_ns_.reset();
  inherited_.clear();
  told_.reset();
  if (publishes()) publish_tick(pending_.deltas, now_ns);
}

std::optional<stream::StreamUpdate> Sharing::take_due(std::int64_t now_ns) {
  if (!pending_since_ns_) return std::nullopt;
  const bool all = ticked_ && std::ranges::all_of(peers_, [&](const auto& entry) {
                     return entry.second.ticked || !encodes(entry.second);
                   });
  if (!all && now_ns - *pending_since_ns_ < patience_ns_) return std::nullopt;
  ticked_ = false;
  for (auto& [source, peer] : peers_) peer.ticked = false;
  pending_since_ns_.reset();
  return std::exchange(pending_, {});
}

std::optional<std::int64_t> Sharing::due_ns() const {
  if (!pending_since_ns_) return std::nullopt;
  return *pending_since_ns_ + patience_ns_;
}

void Sharing::publish_tick(std::vector<stream::DeltaPacket>& deltas, std::int64_t now_ns) {
  const auto offered = model_.offered();
  ShareMessage message{.place = place()};
  message.deltas.swap(deltas);
  message.viewers = viewers_;
  message.viewers->followed = hub_.is_followed();
  std::erase_if(message.viewers->held, [&](std::uint32_t page) {
    return std::ranges::binary_search(*offered, page, {}, &stream::OfferedPage::page);
  });
  const auto same = [](const stream::OfferedPage& a, const stream::OfferedPage& b) {
    return a.page == b.page && a.version == b.version && a.frozen == b.frozen && a.level == b.level;
  };
  if (!told_ || !std::ranges::equal(*told_, *offered, same) || now_ns - told_ns_ >= kSayAgainNs) {
    message.pages = *offered;
    if (message.place.epoch == 0) message.pages->clear();
    told_ = offered;
    told_ns_ = now_ns;
  }
  published_ns_ = now_ns;
  publish(message);
  message.deltas.swap(deltas);
}

void Sharing::publish_visibility(const std::vector<stream::VisibilityPacket>& packets) {
  if (packets.empty() || !publishes()) return;
  ShareMessage message{.place = place()};
  message.visibility = packets;
  publish(message);
}

void Sharing::publish_wants(std::int64_t now_ns) {
  ShareMessage message;
  message.wants = hub_.take_wants(now_ns);
  if (message.wants.empty()) return;
  message.place = place();
  publish(message);
}

void Sharing::publish_still(std::int64_t now_ns) {
  forget_silent(now_ns);
  std::vector<stream::DeltaPacket> none;
  if (publishes() && now_ns - published_ns_ >= kSayAgainNs / 2) publish_tick(none, now_ns);
}

}  // namespace splatbus::streamer
