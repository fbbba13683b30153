#include "streamer/viewer_feed.h"

#include <algorithm>
#include <functional>
#include <utility>

namespace splatbus::streamer {

namespace {

constexpr double kReserve = 0.1;          // of the burst: for scenes
constexpr double kVisibilityShare = 0.3;  // of the rate
// Of the rate, that a second has of pages and deltas, and of all that is asked here; a moment is for what goes beside.
constexpr double kPagesOfASecond = 1.05, kMostOfASecond = 1.09;

}  // namespace

void ViewerFeed::start_over() {
  const ViewerRate rate = rate_;
  const std::uint64_t sequence = sequence_;
  ViewerFeed fresh(max_gaussians_);
  fresh.rate_ = rate;
  fresh.most_kbps_ = most_kbps_;
  fresh.sequence_ = sequence;
  fresh.lost_packets_ = lost_packets_;
  fresh.refused_pages_ = refused_pages_;
  fresh.whole_pages_ = whole_pages_;
  *this = std::move(fresh);
}

double ViewerFeed::largest_packet() const {
  return (1 - kReserve) * rate_.large();
}

void ViewerFeed::begin(std::vector<SharedPacket> packets) {
  control_.assign(std::make_move_iterator(packets.begin()), std::make_move_iterator(packets.end()));
  news_.clear();
  manifest_is_due_ = false;
}

void ViewerFeed::push_news(SharedPacket packet) {
  if (manifest_is_due_) return;
  news_.push_back(std::move(packet));
  if (news_.size() <= kMaxNews) return;
  news_.clear();
  manifest_is_due_ = true;
}

void ViewerFeed::push_visibility(SharedPacket packet, std::shared_ptr<const std::vector<wire::SeenPage>> pages) {
  visibility_.push_back({std::move(packet), std::move(pages)});
  if (visibility_.size() > kMaxVisibility) drop_visibility();
}

// What it does not get in time it gets whole, page by page.
void ViewerFeed::drop_visibility() {
  take_visibility(*visibility_.front().pages, false);
  visibility_.pop_front();
  plan_is_all_ = false;  // nor is it planned
}

void ViewerFeed::push_gone(const stream::StreamModel& model, std::span<const std::uint32_t> pages) {
  std::vector<std::uint32_t> known;
  for (const std::uint32_t page : pages) {
    const bool in_parts = page_ && page_number_ == page;
    if (held_.contains(page) || in_parts) known.push_back(page);
    if (in_parts) page_.reset();
    erase_record(page);
  }
  tell_gone(model, std::move(known));
}

void ViewerFeed::tell_gone(const stream::StreamModel& model, std::vector<std::uint32_t> pages) {
  if (pages.empty()) return;
  auto packet = std::make_shared<WirePacket>(model.gone_packet(pages));
  gone_.push_back({std::move(packet), std::move(pages)});
}

bool ViewerFeed::affords(Kind kind, const SharedPacket& packet, std::int64_t now_ns) {
  const double there = rate_.available(now_ns), burst = rate_.burst();
  const bool first = kind == Kind::Scene || kind == Kind::Control || kind == Kind::News || kind == Kind::Gone;
  const double wanted = static_cast<double>(packet->bytes()) + (first ? 0 : kReserve * burst);
  if (there < std::min(wanted, 0.999 * burst)) return false;
  if (!rate_.second_has_room(static_cast<double>(packet->bytes()), first ? kMostOfASecond : kPagesOfASecond, now_ns)) {
    return false;
  }
  if (!rate_.has_room(static_cast<double>(packet->bytes()), now_ns)) return false;
  offered_ = kind;
  packet_ = packet;
  return true;
}

SharedPacket ViewerFeed::next(stream::StreamModel& model, PageBoard& board, const std::optional<ViewerGaze>& gaze,
                              const ObjectTransforms& objects, std::int64_t now_ns) {
  SharedPacket packet = choose(model, board, gaze, objects, now_ns);
  if (!packet && !waits_) {
    rate_.rest();
    was_whole_ = was_whole_ || !held_.empty();
  }
  return packet;
}

SharedPacket ViewerFeed::choose(stream::StreamModel& model, PageBoard& board, const std::optional<ViewerGaze>& gaze,
                                const ObjectTransforms& objects, std::int64_t now_ns) {
  offered_ = Kind::None;
  waits_ = true;
  const auto offer = [&](Kind kind, const SharedPacket& packet) {
    return affords(kind, packet, now_ns) ? packet : SharedPacket();
  };
  if (control_.empty() && std::exchange(manifest_is_due_, false)) {
    const auto& manifest = board.manifest();
    control_.insert(control_.end(), manifest.begin(), manifest.end());
  }
  if (!control_.empty()) return offer(Kind::Control, control_.front());
  if (!news_.empty()) return offer(Kind::News, news_.front());
  if (!scenes_.empty()) return offer(Kind::Scene, scenes_.front());
  if (!gone_.empty()) return offer(Kind::Gone, gone_.front().packet);
  visibility_bucket_.set(kVisibilityShare * rate_.bytes_per_s(), kVisibilityShare * rate_.bytes_per_s() + 1, now_ns);
  while (!visibility_.empty()) {
    if (affords(Kind::Visibility, visibility_.front().packet, now_ns) &&
        visibility_bucket_.take(static_cast<double>(visibility_.front().packet->bytes()), now_ns)) {
      return packet_;
    }
    offered_ = Kind::None;
    drop_visibility();
  }
  while (true) {
    // What is planned and waits gives way to what is new.
    const bool other = planned_edition_ != board.edition();
    if (other && part_ == 0) page_.reset();
    if (other) delta_.reset();
    if (page_) return offer(Kind::Part, page_->parts[part_]);
    if (delta_) return offer(Kind::Delta, delta_->packet);
    if (!page_visibility_.empty()) return offer(Kind::PageVisibility, page_visibility_.front());
    if (plan_.empty() || other) {
      const bool due = other || (!plan_is_all_ && now_ns - planned_ns_ > 20'000'000);
      if (!due) {
        waits_ = !plan_is_all_;
        return {};
      }
      planned_edition_ = board.edition();
      plan(board, gaze, objects, rate_.available(now_ns) + 0.25 * rate_.bytes_per_s(), now_ns);
      if (!ended_.empty()) {
        drop_ended(model);
        return offer(Kind::Gone, gone_.front().packet);
      }
      if (plan_.empty()) {
        waits_ = !plan_is_all_;
        return {};
      }
    }
    const Item item = plan_.front();
    plan_.pop_front();
    static_cast<void>(begin_item(model, board, item));
  }
}

bool ViewerFeed::begin_item(stream::StreamModel& model, PageBoard& board, const Item& item) {
  if (item.delta != 0) {
    const auto& deltas = board.deltas();
    if (deltas.empty() || item.delta < deltas.front().number) return false;
    const SharedDelta& delta = deltas[item.delta - deltas.front().number];
    if (std::ranges::none_of(fits(held_, delta), std::identity{}) && delta.gone.empty()) return false;
    delta_ = delta;
    return true;
  }
  if (item.visibility) {
    const auto seeing = held_.find(item.page);
    if (seeing == held_.end()) return false;
    if (model.status().layout.appearance != Appearance::Transfer) {
      seeing->second.seen_stale = false;  // there is nothing to be seen, here or at another replica
      return false;
    }
    for (SharedPacket& packet : board.page_visibility(item.page)) page_visibility_.push_back(std::move(packet));
    visibility_page_ = item.page;
    if (page_visibility_.empty() && board.is_of_others(item.page)) plan_is_all_ = false;
    return !page_visibility_.empty();
  }
  const stream::OfferedPage* offered = board.find(item.page);
  if (!offered || !make_room(model, *offered)) return false;
  const auto held = held_.find(item.page);
  if (held != held_.end() && held->second.version >= offered->version) {
    held->second.left_ns = 0;  // a packet that went for other pages has brought it up to date
    return false;
  }
  page_ = board.page(item.page, item.bytes > 0.5 * rate_.large());
  part_ = 0;
  page_number_ = item.page;
  page_count_ = offered->count;
  page_stale_ = false;
  if (!page_ && board.is_of_others(item.page)) plan_is_all_ = false;  // it is on its way: planned again soon
  return page_ != nullptr;
}

bool ViewerFeed::make_room(stream::StreamModel& model, const stream::OfferedPage& page) {
  const auto held = held_.find(page.page);
  const std::size_t more = held != held_.end() ? 0 : page.count;
  const float weight = weights_.contains(page.page) ? weights_.at(page.page) : 0;
  std::vector<std::uint32_t> dropped;
  while (gaussians_ + more > max_gaussians_) {
    // The one that adds least, if that is clearly less: what wavers stays.
    const auto least = std::ranges::min_element(
        held_, {}, [&](const auto& entry) { return weights_.contains(entry.first) ? weights_.at(entry.first) : 0.0F; });
    if (least == held_.end()) return false;
    const float its = weights_.contains(least->first) ? weights_.at(least->first) : 0;
    if (2 * its > weight) return false;
    dropped.push_back(least->first);
    erase_record(least->first);
  }
  tell_gone(model, std::move(dropped));
  return true;
}

void ViewerFeed::sent(std::int64_t now_ns) {
  ++sequence_;
  rate_.take(sequence_, static_cast<double>(packet_->bytes()), now_ns);
  Trace trace{.sequence = sequence_, .control = false, .visibility = false, .marks = {}, .gone = {}};
  switch (offered_) {
    case Kind::Control:
    case Kind::News:
    case Kind::Scene:
      (offered_ == Kind::Control ? control_ : offered_ == Kind::News ? news_ : scenes_).pop_front();
      trace.control = true;
      break;
    case Kind::Gone:
      trace.gone = std::move(gone_.front().pages);
      gone_.pop_front();
      break;
    case Kind::Visibility:
      take_visibility(*visibility_.front().pages, true);
      page_visibility_.clear();  // made before it
      trace.visibility = true;
      for (const wire::SeenPage& page : *visibility_.front().pages) trace.marks.push_back({page.page(), 0, 0});
      visibility_.pop_front();
      break;
    case Kind::PageVisibility:
      page_visibility_.pop_front();
      trace.visibility = true;
      trace.marks.push_back({visibility_page_, 0, 0});
      if (const auto held = held_.find(visibility_page_); page_visibility_.empty() && held != held_.end()) {
        held->second.seen_stale = false;
      }
      break;
    case Kind::Part:
      ++whole_pages_;
      trace.marks.push_back({page_number_, 0, page_->version});
      if (++part_ == page_->parts.size()) {
        set_record(page_number_, {.version = page_->version,
                                  .structure = page_->structure,
                                  .count = page_count_,
                                  .sequence = sequence_,
                                  .seen_stale = page_stale_});
        page_.reset();
      }
      break;
    case Kind::Delta:
      take_delta(*delta_, trace);
      delta_.reset();
      break;
    case Kind::None:
      break;
  }
  traces_.push_back(std::move(trace));
  if (traces_.size() > kMaxTraces) traces_.pop_front();
  packet_.reset();
  offered_ = Kind::None;
}

void ViewerFeed::sent_beside(double bytes, std::int64_t now_ns) {
  ++sequence_;
  rate_.take(sequence_, bytes, now_ns);
}

}  // namespace splatbus::streamer
