// What a viewer is sent next.

#include <algorithm>
#include <cmath>
#include <utility>

#include "streamer/seen_pages.h"
#include "streamer/viewer_feed.h"

namespace splatbus::streamer {

namespace {

// A page that is missing is worth so many of its Gaussians' absences: what it uncovers shows too, and many small steps
// of what is held never hold it up.
constexpr float kMissing = 16;
constexpr float kBehindSteps = 5;  // of a page that has missed deltas which are no longer kept
constexpr float kHidden = 0.01F;   // of what a page would be worth if nothing hid it; outside of the picture too
constexpr std::int64_t kLookNs = 100'000'000;
constexpr float kLeftSteps_s = 5;          // what a page changes in a second, while no delta says it
constexpr std::uint32_t kTicksDeltas = 2;  // that one tick may have of a page: what it is now, and its values
constexpr double kMostDeltaShare = 2.0 / 3, kLeastDeltaShare = 0.1;  // of a viewer's rate
constexpr double kFollowed = 0.9;                                    // of what shows
constexpr float kSeenSteps = 5;                                      // of one that has missed how it sees the lights
constexpr double kSeenBytes = 400;

}  // namespace

// Visits the deltas that make what is held newer, one after the other, with what of each fits; `goes`, whether one
// does.
template <class Goes, class Visit>
void ViewerFeed::walk_deltas(const PageBoard& board, Versions& versions, const Goes& goes, const Visit& visit) const {
  std::vector<const stream::DeltaPacket::Step*> fitting;
  for (const SharedDelta& delta : board.deltas()) {
    if (delta.number < oldest_delta_) continue;
    fitting.clear();
    bool fits = false;
    for (const stream::DeltaPacket::Step& step : delta.steps) {
      const auto base = versions.find(step.base);
      if (base == versions.end() || base->second != step.from_version || !goes(delta, step.base)) continue;
      fitting.push_back(&step);
    }
    for (const auto& [page, version] : delta.gone) {
      const auto held = versions.find(page);
      if (held == versions.end() || held->second > version || !goes(delta, page)) continue;
      fits = true;
      versions.erase(held);
    }
    if (!fits && fitting.empty()) continue;
    for (const auto* step : fitting) versions[step->page] = step->version;
    visit(delta, fitting);
  }
}

// What pages have missed, and which of them come whole: those whose deltas have more bytes than they have themselves.
// Who is slow is sent fewer states of a page rather than all of them later. Pages share a packet's bytes; what those
// that come whole have in it falls to the others, so that these are asked again.
std::set<std::uint32_t> ViewerFeed::find_missed(const PageBoard& board, const Versions& versions) {
  std::set<std::uint32_t> whole;
  missed_.clear();
  add_missed(board, versions, whole, missed_);
  std::map<std::uint32_t, Missed> shared = missed_;
  while (true) {
    const std::size_t before = whole.size();
    for (const auto& [number, missed] : shared) {
      const stream::OfferedPage* page = board.find(number);
      if (page && missed.deltas > kTicksDeltas && missed.bytes > board.bytes_of(*page)) whole.insert(number);
    }
    if (whole.size() == before) return whole;
    shared.clear();
    add_missed(board, versions, whole, shared);
  }
}

void ViewerFeed::add_missed(const PageBoard& board, Versions versions, const std::set<std::uint32_t>& whole,
                            std::map<std::uint32_t, Missed>& all) {
  std::uint64_t oldest = 0;
  const auto goes = [&](const SharedDelta&, std::uint32_t page) { return !whole.contains(page); };
  walk_deltas(board, versions, goes, [&](const SharedDelta& delta, const auto& fitting) {
    if (oldest == 0) oldest = delta.number;
    const auto steps = static_cast<double>(std::max<std::size_t>(fitting.size(), 1));
    for (const auto* step : fitting) {
      Missed& missed = all[step->page];
      missed.bytes += static_cast<double>(delta.packet->bytes()) / steps;
      missed.steps += step->steps;
      ++missed.deltas;
    }
  });
  if (!whole.empty()) return;
  oldest_delta_ = oldest != 0 ? oldest : board.deltas().empty() ? 0 : board.deltas().back().number + 1;
}

void ViewerFeed::plan_deltas(const PageBoard& board, Versions& versions, std::vector<Item>& items) {
  const std::set<std::uint32_t> whole = find_missed(board, versions);
  const auto goes = [&](const SharedDelta& delta, std::uint32_t page) {
    // What is too large for the link never goes: its pages come whole.
    return !whole.contains(page) && static_cast<double>(delta.packet->bytes()) <= largest_packet();
  };
  std::vector<std::vector<const stream::DeltaPacket::Step*>> steps;  // [items]
  walk_deltas(board, versions, goes, [&](const SharedDelta& delta, const auto& fitting) {
    float value = 0;
    for (const auto* step : fitting) {
      const auto weight = weights_.find(step->page);
      value += step->steps * (weight != weights_.end() ? weight->second : 0);
    }
    const auto bytes = static_cast<double>(delta.packet->bytes());
    items.push_back({.score = value / static_cast<float>(bytes), .bytes = bytes, .delta = delta.number});
    steps.push_back(fitting);
  });
  // One that others go on from is worth as much as they are: without it they fit nothing.
  std::map<std::uint32_t, float> worth;  // of what goes on from a page
  for (std::size_t k = items.size(); k-- > 0;) {
    float& score = items[k].score;
    for (const auto* step : steps[k]) score = std::max(score, worth[step->page]);
    for (const auto* step : steps[k]) worth[step->base] = std::max(worth[step->base], score);
  }
}

void ViewerFeed::plan(PageBoard& board, const std::optional<ViewerGaze>& gaze, const ObjectTransforms& objects,
                      double budget_bytes, std::int64_t now_ns) {
  const std::int64_t before_ns = planned_ns_ != 0 ? planned_ns_ : now_ns;
  planned_ns_ = now_ns;
  weights_.clear();
  for (const stream::OfferedPage& page : board.offered()) {
    weights_.emplace_hint(weights_.end(), page.page, page_weight(page, gaze, objects));
  }
  look(board, gaze, objects);
  std::vector<Item> items;
  Versions versions;
  for (const auto& [page, record] : held_) versions.emplace_hint(versions.end(), page, record.version);
  plan_deltas(board, versions, items);
  ended_.clear();
  for (const auto& [page, version] : versions) {
    if (!board.find(page) && held_.contains(page)) ended_.push_back(page);
  }

  std::erase_if(declined_, [&](const auto& entry) { return entry.second < planned_ns_; });
  double followed = 0, all = 0;
  bool lacks = false;
  for (const stream::OfferedPage& page : board.offered()) {
    if (declined_.contains(page.page)) continue;
    const float weight = weights_.at(page.page);
    const auto version = versions.find(page.page);
    const auto held = held_.find(page.page);
    // A pixel for each Gaussian at most, since spheres overlap in the picture. What there is no room for never comes.
    const bool fits = held != held_.end() || gaussians_ + page.count <= max_gaussians_;
    const float shows = fits ? std::min(weight, static_cast<float>(page.count)) : 0;
    all += shows;
    if (version != versions.end() && version->second >= page.version) {
      if (held != held_.end()) held->second.left_ns = 0;
      followed += shows;
      if (held != held_.end() && held->second.seen_stale) {
        items.push_back({.score = weight * kSeenSteps / static_cast<float>(kSeenBytes),
                         .bytes = kSeenBytes,
                         .delta = 0,
                         .page = page.page,
                         .visibility = true});
      }
      continue;
    }
    lacks = lacks || (held == held_.end() && fits);
    const double bytes = board.bytes_of(page);
    const auto missed = missed_.find(page.page);
    float off = std::max(kBehindSteps, missed != missed_.end() ? missed->second.steps : 0);
    if (held != held_.end()) {
      // Of what no viewer follows there are no deltas that say how much has changed.
      if (held->second.left_ns == 0) held->second.left_ns = planned_ns_;
      off += kLeftSteps_s * static_cast<float>(planned_ns_ - held->second.left_ns) * 1e-9F;
    }
    // However old, what is held shows more than nothing; what has missed most comes first, however much all have
    // missed.
    const float behind = stream::kAbsentSteps * std::log1p(off / stream::kAbsentSteps);
    const float steps = held != held_.end() ? behind : kMissing * stream::kAbsentSteps;
    const float worth = held != held_.end() ? weight : unhidden(page.page, weight);
    items.push_back(
        {.score = worth * steps / static_cast<float>(bytes), .bytes = bytes, .delta = 0, .page = page.page});
  }
  was_whole_ = was_whole_ || (!lacks && !held_.empty());
  learn_delta_share(board, followed / std::max(all, 1e-9), planned_ns_ - before_ns);
  order(std::move(items), budget_bytes);
}

void ViewerFeed::look(PageBoard& board, const std::optional<ViewerGaze>& gaze, const ObjectTransforms& objects) {
  if (!gaze || held_.size() >= board.offered().size()) return;
  if (looked_ns_ != 0 && planned_ns_ - looked_ns_ < kLookNs) return;
  if (!board.may_look(planned_ns_)) return;
  looked_ns_ = planned_ns_;
  seen_px2_ = seen_areas_px2(board.offered(), gaze->now, objects);
  if (gaze->soon == gaze->now) return;
  for (const auto& [page, area_px2] : seen_areas_px2(board.offered(), gaze->soon, objects)) {
    float& greatest = seen_px2_[page];
    greatest = std::max(greatest, area_px2);
  }
}

float ViewerFeed::unhidden(std::uint32_t page, float weight) const {
  const auto seen = seen_px2_.find(page);
  return seen != seen_px2_.end() ? std::max(seen->second, kHidden * weight) : weight;
}

// A page that has missed much costs fewer bytes whole than all that it has missed, so that deltas which are made before
// it has come are made in vain. Once all are followed deltas grow again, as slowly as all pages would come whole: what
// they take too much of leaves pages behind, and these take long to come.
void ViewerFeed::learn_delta_share(const PageBoard& board, double followed, std::int64_t since_ns) {
  double model_bytes = 0;
  for (const stream::OfferedPage& page : board.offered()) model_bytes += board.bytes_of(page);
  if (followed < kFollowed) {
    delta_share_ = kLeastDeltaShare;
  } else if (model_bytes > 0) {
    const double models = static_cast<double>(since_ns) * 1e-9 * rate_.bytes_per_s() / model_bytes;
    delta_share_ = std::min(delta_share_ + models * (kMostDeltaShare - kLeastDeltaShare), kMostDeltaShare);
  }
}

// As much as the rate allows for; deltas among it in their order, since each goes on where one before has ended.
void ViewerFeed::order(std::vector<Item> items, double budget_bytes) {
  std::ranges::stable_sort(items, std::greater<>{}, &Item::score);
  double left = budget_bytes;
  std::size_t count = 0;
  while (count < items.size() && left > 0) left -= items[count++].bytes;
  plan_is_all_ = count == items.size();
  items.resize(count);
  std::vector<std::uint64_t> deltas;
  for (const Item& item : items) {
    if (item.delta != 0) deltas.push_back(item.delta);
  }
  std::ranges::sort(deltas);
  std::size_t k = 0;
  for (Item& item : items) {
    if (item.delta != 0) item.delta = deltas[k++];
  }
  plan_.assign(items.begin(), items.end());
}

}  // namespace splatbus::streamer
