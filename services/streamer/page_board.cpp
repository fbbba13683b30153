#include "streamer/page_board.h"

#include <algorithm>
#include <utility>

namespace splatbus::streamer {

namespace {

constexpr std::size_t kMaxDeltas = 512;

constexpr std::int64_t kLookNsPerPage = 35'000;  // five times what a look and one ahead take (bench_join)

bool same_manifest(const stream::OfferedPage& a, const stream::OfferedPage& b) {
  return a.structure == b.structure && a.frozen == b.frozen && a.level == b.level;
}

}  // namespace

std::vector<std::uint32_t> PageBoard::add(stream::StreamUpdate update, BoardPages pages,
                                          std::vector<stream::OfferedPage>& changed) {
  ++edition_;
  offer_others(pages);
  for (stream::DeltaPacket& delta : update.deltas) {
    auto packet = std::make_shared<WirePacket>(delta.packet);
    bytes_ += packet->bytes();
    deltas_.push_back({++number_, std::move(packet), std::move(delta.steps), std::move(delta.gone)});
  }
  while (deltas_.size() > 1 && (bytes_ > max_bytes_ || deltas_.size() > kMaxDeltas)) {
    bytes_ -= deltas_.front().packet->bytes();
    deltas_.pop_front();
  }
  const auto before = std::exchange(offered_, std::move(pages.all));
  std::vector<std::uint32_t> gone;
  for (const stream::OfferedPage& page : *before) {
    if (!find(page.page)) gone.push_back(page.page);
  }
  auto old = before->begin();
  for (const stream::OfferedPage& page : *offered_) {
    while (old != before->end() && old->page < page.page) ++old;
    if (old == before->end() || old->page != page.page || !same_manifest(*old, page)) changed.push_back(page);
  }
  std::erase_if(pages_, [&](const auto& entry) {
    const stream::OfferedPage* page = find(entry.first.first);
    return !page || page->version > entry.second->version ||
           (page->version < entry.second->version && !is_of_others(page->page));
  });
  return gone;
}

void PageBoard::clear() {
  ++edition_;
  deltas_.clear();
  bytes_ = 0;
  pages_.clear();
  offered_ = std::make_shared<std::vector<stream::OfferedPage>>();
  of_others_.clear();
  seen_.clear();
  wanted_.clear();
  visibility_version_ = model_.status().visibility_version;  // 0, but of a stream that another streamer has handed over
}

const stream::OfferedPage* PageBoard::find(std::uint32_t page) const {
  const auto found = std::ranges::lower_bound(*offered_, page, {}, &stream::OfferedPage::page);
  return found != offered_->end() && found->page == page ? &*found : nullptr;
}

std::shared_ptr<const SharedPage> PageBoard::page(std::uint32_t number, bool in_parts, bool to_hold) {
  const bool of_others = is_of_others(number);
  if (const stream::OfferedPage* small = find(number); of_others && small && small->count <= stream::kBlockRows) {
    in_parts = false;  // it is one
  }
  if (const auto kept = pages_.find({number, in_parts}); kept != pages_.end()) {
    // Made anew once for the first who goes on with it: that is how the model learns of him.
    if (kept->second->to_hold || !to_hold) return kept->second;
  }
  if (of_others) {
    need({number, in_parts ? wire::SharePart::Parts : wire::SharePart::Whole});
    return {};
  }
  auto page = std::make_shared<SharedPage>();
  page->to_hold = to_hold;
  std::size_t bytes = 0;
  for (const stream::PagePacket& part :
       model_.page_packets(number, in_parts ? stream::kBlockRows : splatbus::kPageLanes, to_hold)) {
    page->version = part.version;
    page->structure = part.structure;
    page->parts.push_back(std::make_shared<WirePacket>(part.packet));
    bytes += page->parts.back()->bytes();
  }
  if (page->parts.empty()) return {};
  learn_bytes(number, bytes);
  return pages_[{number, in_parts}] = std::move(page);
}

const std::vector<SharedPacket>& PageBoard::manifest() {
  if (manifest_.empty() || manifest_edition_ != edition_) {
    manifest_edition_ = edition_;
    manifest_.clear();
    for (const auto& packet : manifest_packets(*offered_, {}, true)) {
      manifest_.push_back(std::make_shared<WirePacket>(packet));
    }
  }
  return manifest_;
}

SharedPacket PageBoard::layout() {
  if (!layout_ || layout_edition_ != edition_) {
    layout_edition_ = edition_;
    layout_ = std::make_shared<WirePacket>(model_.layout_packet());
  }
  return layout_;
}

void PageBoard::learn_bytes(std::uint32_t page, std::size_t bytes) {
  const stream::OfferedPage* offered = find(page);
  if (!offered || offered->count == 0) return;
  bytes_per_gaussian_ += 0.1 * (static_cast<double>(bytes) / offered->count - bytes_per_gaussian_);
}

void PageBoard::forget(const std::vector<wire::SeenPage>& pages) {
  for (const wire::SeenPage& page : pages) {
    pages_.erase({page.page(), false});
    pages_.erase({page.page(), true});
    seen_.erase(page.page());
  }
}

bool PageBoard::may_look(std::int64_t now_ns) {
  if (now_ns < next_look_ns_) return false;
  next_look_ns_ = now_ns + static_cast<std::int64_t>(offered_->size()) * kLookNsPerPage;
  return true;
}

double PageBoard::bytes_of(const stream::OfferedPage& page) const {
  return 150 + bytes_per_gaussian_ * page.count;
}

}  // namespace splatbus::streamer
