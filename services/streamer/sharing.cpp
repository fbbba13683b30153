// Who shares, and what a tick is to do.

#include "streamer/sharing.h"

#include <algorithm>
#include <tuple>
#include <utility>

#include "wire/system_generated.h"

namespace splatbus::streamer {

namespace {

constexpr std::int64_t kHearOthersNs = 2'000'000'000;  // after the start
constexpr std::int64_t kGivenNs = 1'000'000'000;       // until who was given a page says that viewers hold it
constexpr std::size_t kCameras = 4;                    // of a tick

}  // namespace

Sharing::Sharing(std::string own, const bus::Publisher& publisher, stream::StreamModel& model, ViewerHub& hub,
                 const stream::StreamerChoice& others, double tick_hz)
    : own_(std::move(own)),
      publisher_(publisher),
      model_(model),
      hub_(hub),
      others_(others),
      patience_ns_(static_cast<std::int64_t>(0.25e9 / tick_hz)),
      division_({own_}) {}

void Sharing::take(const wire::Liveness& liveness) {
  if (liveness.nodes() == nullptr) return;
  std::set<std::string> living;
  for (const auto* node : *liveness.nodes()) {
    const bool alive =
        node->alive() && node->state() != wire::ServiceState::Stopping && node->service()->string_view() == "streamer";
    if (alive) living.insert(node->source()->str());
    // Of one that the broker has not heard of yet it says nothing.
    const auto peer = peers_.find(node->source()->str());
    if (peer == peers_.end()) continue;
    const bool same = node->epoch() == peer->second.incarnation;
    if (alive && node->epoch() > peer->second.incarnation) {
      heard(peer->first, node->epoch());
    } else if (same || node->epoch() == 0) {
      peer->second.alive = alive;
    }
  }
  std::erase_if(known_, [&](const std::string& source) {
    const auto peer = peers_.find(source);
    return !living.contains(source) && (peer == peers_.end() || !peer->second.alive);
  });
}

bool Sharing::same_stream(const ShareMessage::Place& a, const ShareMessage::Place& b) {
  return a.epoch != 0 && a.epoch == b.epoch && a.layout == b.layout && a.mean_step == b.mean_step;
}

ShareMessage::Place Sharing::place() const {
  const stream::StreamModel::Status status = model_.status();
  if (!status.ready) return {.version = status.version};
  return {.epoch = status.epoch,
          .layout = status.layout,
          .mean_step = status.mean_step,
          .version = std::max(status.version, newest_of_ == status.epoch ? newest_ : 0),
          .encodes = !draining_};
}

bool Sharing::may_begin(std::int64_t now_ns) {
  if (started_ns_ == 0) started_ns_ = now_ns;
  const bool tell = std::ranges::all_of(peers_, [](const auto& entry) { return entry.second.told; });
  const bool hears = peers_.empty() ? !others_.others_serve(own_) : tell;
  return place_.epoch != 0 || hears || now_ns - started_ns_ > kHearOthersNs;
}

bool Sharing::others_are_followed() const {
  return std::ranges::any_of(peers_, [](const auto& entry) { return entry.second.viewers.followed; });
}

void Sharing::forget_silent(std::int64_t now_ns) {
  std::erase_if(peers_, [&](const auto& entry) {
    const bool silent = now_ns - entry.second.heard_ns > kSilentNs;
    if (silent) inherit_pages(entry.second);
    return silent;
  });
}

void Sharing::inherit_pages(const Peer& peer) {
  if (!in_stream(peer)) return;
  for (const stream::OfferedPage& page : peer.pages) inherited_[page.page] = {.page = page};
}

/// Whose stream this one should be in; null: it is in the right one, or in none with anybody.
const Sharing::Peer* Sharing::to_join() const {
  const Peer* lowest = nullptr;
  for (const auto& [source, peer] : peers_) {
    if (!peer.alive || !peer.place.encodes || !peer.told || is_spent(peer.place)) continue;
    if (place_.epoch != 0 && peer.place.layout != place_.layout) continue;  // one of the two has not seen the newest
    if (lowest == nullptr || peer.place.epoch < lowest->place.epoch) lowest = &peer;
  }
  if (lowest == nullptr || (place_.epoch != 0 && lowest->place.epoch >= place_.epoch)) return nullptr;
  return lowest;
}

bool Sharing::is_spent(const ShareMessage::Place& place) {
  return place.version / kVersionBlock + 2 + kMaxPeers + 1 >= kVersionBlocks;
}

// Above all that anybody has said in that stream, and by a block more than anybody can have used without being heard.
// Replicas that each take the others for dead use blocks of their own: as many as there are names take turns.
std::uint32_t Sharing::version_floor() const {
  const stream::StreamModel::Status status = model_.status();
  std::uint32_t newest = std::max(newest_of_ == goal_.epoch ? newest_ : 0,  //
                                  status.epoch == goal_.epoch ? status.version : 0);
  for (const auto& [source, peer] : peers_) {
    if (same_stream(peer.place, goal_)) newest = std::max(newest, peer.place.version);
  }
  const auto before = static_cast<std::uint32_t>(
      std::ranges::count_if(known_, [this](const std::string& source) { return source < own_; }));
  const auto turns = static_cast<std::uint32_t>(known_.size() + 1), block = newest / kVersionBlock + 2;
  return std::min(block + (before + turns - block % turns) % turns, kVersionBlocks - 1) * kVersionBlock;
}

/// True when somebody is gone, whose pages others have now.
bool Sharing::divide() {
  std::vector<std::string> sources;
  for (const auto& [source, peer] : peers_) {
    if (encodes(peer)) sources.push_back(source);
  }
  if (!draining_ || sources.empty()) sources.push_back(own_);
  std::ranges::sort(sources);
  if (sources == division_.sources()) return false;
  const PageDivision before = std::exchange(division_, PageDivision(std::move(sources)));
  return !std::ranges::includes(division_.sources(), before.sources());
}

/// Takes out what others have. True when one of them is to be encoded here, and anew: another one has taken it for its
/// own meanwhile, with a version that is not below this one's.
bool Sharing::leave_pages(EncodedPages& pages) const {
  bool contested = false;
  for (const auto& [source, peer] : peers_) {
    if (!same_stream(peer.place, goal_)) continue;
    auto own = pages.kept->begin();
    for (const stream::OfferedPage& page : peer.pages) {
      own = std::lower_bound(own, pages.kept->end(), page.page,
                             [](const stream::OfferedPage& a, std::uint32_t number) { return a.page < number; });
      if (own == pages.kept->end()) break;
      if (own->page != page.page) continue;
      const std::string& owner = pages.division.owner_of(page.page);
      const bool is_contested = owner == own_ && page.version >= own->version;
      if (is_contested || (owner == source && page.version > own->version)) pages.left.insert(page.page);
      contested = contested || is_contested;
    }
  }
  return contested;
}

TickShare Sharing::begin_tick(std::int64_t now_ns) {
  forget_silent(now_ns);
  for (auto& [number, inherited] : inherited_) {
    if (!inherited.tick_ns) inherited.tick_ns = now_ns;
  }
  TickShare share;
  if (is_spent(place())) model_.release();
  if (!model_.status().ready) place_ = {};  // what begins anew joins those that there are
  const Peer* const joined = to_join();
  goal_ = joined ? joined->place : place_;
  if (joined) {
    share.origin = {
        .epoch = goal_.epoch, .layout = goal_.layout, .mean_step = goal_.mean_step, .version = version_floor()};
  }
  const bool gains = divide();
  if (gains) share.raise_version = version_floor();
  const auto shares = [this](const auto& entry) { return same_stream(entry.second.place, goal_); };
  if (std::ranges::none_of(peers_, shares)) return share;
  EncodedPages pages{.own = own_, .division = division_, .kept = {}, .left = {}};
  pages.kept = share.origin ? std::make_shared<std::vector<stream::OfferedPage>>() : model_.offered();
  if (leave_pages(pages)) share.raise_version = version_floor();
  share.pages = std::make_shared<const EncodedPages>(std::move(pages));
  return share;
}

std::set<std::uint32_t> Sharing::holders(std::int64_t now_ns) {
  viewers_.held = hub_.followed_pages();
  std::set<std::uint32_t> pages = viewers_.held;
  std::erase_if(given_ns_, [&](const auto& entry) { return now_ns - entry.second > kGivenNs; });
  for (const auto& [page, given] : given_ns_) pages.insert(page);
  for (const auto& [source, peer] : peers_) pages.insert(peer.viewers.held.begin(), peer.viewers.held.end());
  return pages;
}

std::vector<Camera> Sharing::cameras() {
  viewers_.cameras = hub_.cameras();
  std::vector<Camera> all = viewers_.cameras;
  for (const auto& [source, peer] : peers_) {
    all.insert(all.end(), peer.viewers.cameras.begin(), peer.viewers.cameras.end());
  }
  if (all.size() <= kCameras) return all;
  // As many as one streamer looks through; whose they are takes turns.
  std::vector<Camera> some;
  for (std::size_t k = 0; k < kCameras; ++k) some.push_back(all[camera_turn_++ % all.size()]);
  return some;
}

std::optional<double> Sharing::delta_bytes_per_s() {
  std::optional<double> most = hub_.delta_bytes_per_s();
  viewers_.bytes_per_s = most.value_or(0);
  for (const auto& [source, peer] : peers_) {
    if (peer.viewers.bytes_per_s > 0) most = std::max(most.value_or(0), peer.viewers.bytes_per_s);
  }
  return most;
}

// Own pages before others', and of those the one whose page it is; otherwise the newest.
BoardPages Sharing::pages() const {
  const auto own = model_.offered();
  const bool shared = std::ranges::any_of(peers_, [&](const auto& entry) { return in_stream(entry.second); });
  if (!shared && inherited_.empty()) return {.all = own, .of_others = {}};
  struct Offer {
    const stream::OfferedPage* page;
    int rank;
  };
  std::vector<Offer> offers;
  for (const stream::OfferedPage& page : *own) offers.push_back({&page, 0});
  for (const auto& [source, peer] : peers_) {
    if (!in_stream(peer)) continue;
    for (const stream::OfferedPage& page : peer.pages) {
      offers.push_back({&page, division_.owner_of(page.page) == source ? 1 : 2});
    }
  }
  for (const auto& [number, inherited] : inherited_) offers.push_back({&inherited.page, 3});
  std::ranges::sort(offers, [](const Offer& a, const Offer& b) {
    return std::tuple(a.page->page, a.rank, b.page->version) < std::tuple(b.page->page, b.rank, a.page->version);
  });
  auto all = std::make_shared<std::vector<stream::OfferedPage>>();
  BoardPages out;
  for (const Offer& offer : offers) {
    if (!all->empty() && all->back().page == offer.page->page) continue;
    all->push_back(*offer.page);
    if (offer.rank > 0) out.of_others.push_back(offer.page->page);
  }
  out.all = std::move(all);
  return out;
}

}  // namespace splatbus::streamer
