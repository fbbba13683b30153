// What a viewer is sent next, and how fast.

#include <algorithm>
#include <cmath>
#include <utility>

#include "streamer/viewer_feed.h"

namespace splatbus::streamer {

namespace {

constexpr float kBehindSteps = 5;  // of a page that has missed deltas which are no longer kept
constexpr float kSeenSteps = 5;    // of one that has missed how it sees the lights
constexpr double kSeenBytes = 400;
constexpr double kFirstAuto = 1.25e6, kLeastAuto = 6e4, kMostAuto = 1.25e8;  // bytes a second
constexpr double kQueued_s = 0.5;

}  // namespace

void ViewerRate::use(double bytes_per_s, std::int64_t now_ns) {
  const bool first = bytes_per_s_ == 0;
  bytes_per_s_ = bytes_per_s;
  if (first) bucket_ = bus::TokenBucket(bytes_per_s_, burst());
  bucket_.set(bytes_per_s_, burst(), now_ns);
}

void ViewerRate::set(double kbps, std::int64_t now_ns) {
  if (kbps == kbps_) return;
  kbps_ = kbps;
  auto_ = kbps <= 0;
  use(auto_ ? kFirstAuto : kbps * 125, now_ns);
}

double ViewerRate::available(std::int64_t now_ns) {
  if (debt_ > 0) {
    const double paid = std::min(debt_, bucket_.available(now_ns));
    if (bucket_.take(paid, now_ns)) debt_ -= paid;
  }
  return debt_ > 0 ? 0 : bucket_.available(now_ns);
}

void ViewerRate::take(double bytes, std::int64_t now_ns) {
  in_flight_ += bytes;
  sent_since_ += bytes;
  const double there = std::min(bytes, bucket_.available(now_ns));
  if (bucket_.take(there, now_ns)) debt_ += bytes - there;
}

// More than half a second's worth on the way: the link takes less. As much as is sent arrives: it may take more.
void ViewerRate::acknowledged(double bytes, double window_s, std::int64_t now_ns) {
  in_flight_ = std::max(0.0, in_flight_ - bytes);
  const double sent = std::exchange(sent_since_, 0);
  if (!auto_ || window_s < 0.01) return;
  const double arrived = bytes / window_s;
  if (in_flight_ > kQueued_s * bytes_per_s_) {
    use(std::clamp(0.9 * std::min(arrived, bytes_per_s_), kLeastAuto, kMostAuto), now_ns);
  } else if (sent > 0.8 * bytes_per_s_ * window_s) {
    use(std::min(1.1 * bytes_per_s_, kMostAuto), now_ns);
  }
}

void ViewerFeed::plan_deltas(const PageBoard& board, std::map<std::uint32_t, std::uint32_t>& versions,
                             std::vector<Item>& items) {
  std::uint64_t oldest = 0;
  for (const SharedDelta& delta : board.deltas()) {
    // What is larger than the rate's burst never goes: its pages come whole.
    if (delta.number < oldest_delta_ || static_cast<double>(delta.packet->bytes()) > largest_packet()) continue;
    float value = 0;
    bool fits = false;
    std::vector<std::pair<std::uint32_t, std::uint32_t>> after;
    for (const stream::DeltaPacket::Step& step : delta.steps) {
      const auto base = versions.find(step.base);
      if (base == versions.end() || base->second != step.from_version) continue;
      fits = true;
      const auto weight = weights_.find(step.page);
      value += step.steps * (weight != weights_.end() ? weight->second : 0);
      after.emplace_back(step.page, step.version);
    }
    for (const auto& [page, version] : delta.gone) {
      const auto held = versions.find(page);
      if (held == versions.end() || held->second > version) continue;
      fits = true;
      versions.erase(held);
    }
    if (!fits) continue;
    for (const auto& [page, version] : after) versions[page] = version;
    const auto bytes = static_cast<double>(delta.packet->bytes());
    if (oldest == 0) oldest = delta.number;
    items.push_back({.score = value / static_cast<float>(bytes), .bytes = bytes, .delta = delta.number});
  }
  oldest_delta_ = oldest != 0 ? oldest : board.deltas().empty() ? 0 : board.deltas().back().number + 1;
}

void ViewerFeed::plan(const PageBoard& board, const std::optional<ViewerGaze>& gaze, const ObjectTransforms& objects,
                      double budget_bytes) {
  weights_.clear();
  for (const stream::OfferedPage& page : board.offered()) {
    weights_.emplace_hint(weights_.end(), page.page, page_weight(page, gaze, objects));
  }
  std::vector<Item> items;
  std::map<std::uint32_t, std::uint32_t> versions;
  for (const auto& [page, record] : held_) versions.emplace_hint(versions.end(), page, record.version);
  plan_deltas(board, versions, items);

  std::erase_if(declined_, [&](const auto& entry) { return entry.second < planned_ns_; });
  for (const stream::OfferedPage& page : board.offered()) {
    if (declined_.contains(page.page)) continue;
    const float weight = weights_.at(page.page);
    const auto version = versions.find(page.page);
    const auto held = held_.find(page.page);
    if (version != versions.end() && version->second >= page.version) {
      if (held != held_.end() && held->second.seen_stale) {
        items.push_back({.score = weight * kSeenSteps / static_cast<float>(kSeenBytes),
                         .bytes = kSeenBytes,
                         .delta = 0,
                         .page = page.page,
                         .visibility = true});
      }
      continue;
    }
    const double bytes = board.bytes_of(page);
    const float steps = held != held_.end() ? kBehindSteps : stream::kAbsentSteps;
    items.push_back(
        {.score = weight * steps / static_cast<float>(bytes), .bytes = bytes, .delta = 0, .page = page.page});
  }
  order(std::move(items), budget_bytes);
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
