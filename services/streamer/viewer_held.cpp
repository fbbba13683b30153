// What a viewer holds, as far as is known, and what it says of that.

#include <algorithm>
#include <utility>

#include "streamer/viewer_feed.h"

namespace splatbus::streamer {

namespace {

constexpr std::int64_t kDeclinedNs = 5'000'000'000;

}  // namespace

void ViewerFeed::resume(const PageBoard& board, const std::vector<stream::PageVersion>& held, bool visibility_current) {
  start_over();
  for (const auto& [number, version] : held) {
    const stream::OfferedPage* page = board.find(number);
    if (version == 0) continue;
    const bool same = page && page->version == version;
    set_record(number, {.version = version,
                        .structure = same ? page->structure : 0,
                        .count = page ? page->count : 0,
                        .sequence = 0,
                        .seen_stale = !same || !visibility_current});
  }
}

void ViewerFeed::set_record(std::uint32_t page, const Record& record) {
  Record& kept = held_[page];
  gaussians_ += record.count;
  gaussians_ -= kept.count;
  kept = record;
}

void ViewerFeed::erase_record(std::uint32_t page) {
  const auto found = held_.find(page);
  if (found == held_.end()) return;
  gaussians_ -= found->second.count;
  held_.erase(found);
}

std::vector<bool> ViewerFeed::fits(const std::map<std::uint32_t, Record>& held, const SharedDelta& delta) {
  std::vector<bool> out;
  for (const auto& step : delta.steps) {
    const auto base = held.find(step.base);
    out.push_back(base != held.end() && base->second.version == step.from_version);
  }
  return out;
}

void ViewerFeed::take_delta(const SharedDelta& delta, Trace& trace) {
  const std::vector<bool> fit = fits(held_, delta);
  std::vector<std::pair<std::uint32_t, Record>> records;
  for (std::size_t k = 0; k < fit.size(); ++k) {
    const stream::DeltaPacket::Step& step = delta.steps[k];
    if (!fit[k]) continue;
    Record record = held_.at(step.base);
    record.version = step.version;
    record.count = step.count;
    if (step.other_lanes) record.structure = step.version;
    record.sequence = sequence_;
    records.emplace_back(step.page, record);
    trace.marks.push_back({step.page, step.base == step.page ? step.from_version : 0, step.version});
  }
  for (const auto& [page, record] : records) set_record(page, record);
  for (const auto& [page, version] : delta.gone) {
    if (const auto held = held_.find(page); held != held_.end() && held->second.version <= version) erase_record(page);
  }
}

void ViewerFeed::take_visibility(const std::vector<wire::SeenPage>& pages, bool came) {
  for (const wire::SeenPage& page : pages) {
    page_stale_ = page_stale_ || (page_ && page.page() == page_number_);
    const auto held = held_.find(page.page());
    if (held != held_.end() && (!came || held->second.structure != page.structure())) held->second.seen_stale = true;
  }
}

void ViewerFeed::miss_visibility(const std::vector<wire::SeenPage>& pages) {
  take_visibility(pages, false);
  plan_is_all_ = false;
}

void ViewerFeed::lose(const stream::StreamModel& model, const Trace& trace) {
  ++lost_packets_;
  for (const Mark& mark : trace.marks) {
    const auto held = held_.find(mark.page);
    if (held == held_.end()) continue;
    if (trace.visibility) {
      held->second.seen_stale = true;
    } else if (mark.from_version != 0 && held->second.version == mark.version) {
      held->second.version = mark.from_version;
    } else {
      erase_record(mark.page);
    }
  }
  // What has been sent again since is held.
  std::vector<std::uint32_t> gone = trace.gone;
  std::erase_if(gone, [&](std::uint32_t page) { return held_.contains(page) || (page_ && page_number_ == page); });
  tell_gone(model, std::move(gone));
}

void ViewerFeed::drop_ended(const stream::StreamModel& model) {
  for (const std::uint32_t page : ended_) erase_record(page);
  tell_gone(model, std::exchange(ended_, {}));
}

bool ViewerFeed::acknowledge(const Said& said, const stream::StreamModel& model, std::int64_t now_ns) {
  rate_.acknowledged(std::min(said.newest, sequence_), now_ns);
  most_kbps_ = said.most_kbps;
  bool anew = false;
  for (const stream::SequenceRange& range : said.missing) {
    if (range.first > range.last || range.last > sequence_) continue;
    const auto first = std::ranges::lower_bound(traces_, range.first, {}, &Trace::sequence);
    const auto last = std::ranges::upper_bound(traces_, range.last, {}, &Trace::sequence);
    if (first == last) continue;
    for (auto at = first; at != last; ++at) {  // clang 14 knows no std::ranges::subrange of libstdc++
      const Trace& trace = *at;
      anew = anew || trace.control;
      lose(model, trace);
    }
    traces_.erase(first, last);  // each is lost once, however often a viewer says so
    planned_edition_ = oldest_delta_ = 0;
  }
  const std::uint64_t newest = std::min(said.newest, sequence_);
  while (!traces_.empty() && traces_.front().sequence <= newest) traces_.pop_front();
  for (const auto& [page, version] : said.lacks) {
    const auto held = held_.find(page);
    if (held == held_.end() || held->second.sequence > newest || held->second.version == version) continue;
    ++refused_pages_;
    planned_edition_ = oldest_delta_ = 0;
    if (version == 0) {
      erase_record(page);
    } else {
      held->second.version = version;
      held->second.structure = 0;
      held->second.seen_stale = true;
    }
  }
  for (const std::uint32_t page : said.dropped) {
    ++refused_pages_;
    erase_record(page);
    if (declined_.size() < kMaxTraces) declined_[page] = now_ns + kDeclinedNs;
  }
  return anew;
}

void ViewerFeed::follow_pages(std::set<std::uint32_t>& pages) const {
  for (const auto& [page, record] : held_) {
    if (record.left_ns == 0) pages.insert(page);
  }
  if (page_) pages.insert(page_number_);
}

}  // namespace splatbus::streamer
