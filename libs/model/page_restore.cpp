// Pages of a PageStore that come from somewhere else, and go there.

#include <algorithm>
#include <set>
#include <tuple>

#include "model/page_store.h"

namespace splatbus::model {

std::vector<std::uint32_t> PageStore::restore(std::span<const PageContent> pages, std::uint64_t next_gaussian_id) {
  std::vector<std::uint32_t> placed(pages.size(), kNotInserted);
  using Key = std::tuple<std::uint32_t, std::uint64_t, std::uint64_t>;
  std::set<Key> keys;
  for (const Page& page : directory_) {
    const PageStructure& now = table_.entry(page.page).now;
    keys.emplace(now.frame_id, now.morton_first, now.id_first);
  }
  std::vector<PageChange> changes;
  std::vector<std::uint32_t> block(page_words(layout_));
  std::size_t room_left = room();
  for (std::size_t p = 0; p < pages.size(); ++p) {
    const PageContent& content = pages[p];
    PageStructure next = content.structure;
    if (!is_present(next.state) || next.count == 0 || next.count > kPageLanes ||
        content.words.size() != content_words(layout_, next.count)) {
      continue;
    }
    const std::vector<std::uint32_t> lanes = sound_lanes(layout_, content, next_gaussian_id);
    if (lanes.empty() || lanes.size() > room_left) continue;
    if (free_.empty()) reserve_pages(1);
    if (free_.empty() || !keys.emplace(next.frame_id, next.morton_first, next.id_first).second) continue;
    const std::uint32_t page = free_.back();
    free_.pop_back();
    unpack_page(layout_, content, lanes, block.data());
    device::copy(stream_, memory_.words + page * memory_.page_words, block.data(),
                 std::size_t{memory_.used_rows} * kRowWords * sizeof(std::uint32_t));
    stream_.wait();  // the block is the next page's
    next.count = static_cast<std::uint32_t>(lanes.size());
    table_.entry(page).loss = -1;
    room_left -= lanes.size();
    changes.push_back({.page = page, .next = next, .bounds = {}, .fresh = {page * kPageLanes, next.count}});
    directory_.push_back({next.frame_id, page, next.count, next.morton_first, next.id_first});
    placed[p] = page;
  }
  bound(changes);
  sort_directory();
  apply(changes, next_gaussian_id, std::nullopt);
  return placed;
}

void PageStore::set_progress(std::uint64_t step, std::uint64_t views, double optimizer_s) {
  PageTableHeader& header = table_.header();
  header.step = step;
  header.views = views;
  header.optimizer_s = optimizer_s;
}

void PageStore::take_out(std::span<const std::uint32_t> pages) {
  std::vector<std::uint32_t> gone(pages.begin(), pages.end());
  std::sort(gone.begin(), gone.end());
  gone.erase(std::unique(gone.begin(), gone.end()), gone.end());
  std::vector<PageChange> changes;
  std::erase_if(directory_, [&](const Page& page) {
    if (!std::binary_search(gone.begin(), gone.end(), page.page)) return false;
    changes.push_back({.page = page.page, .next = {}, .bounds = {}, .fresh = {}});
    return true;
  });
  if (changes.empty()) return;
  apply(changes, next_gaussian_id(), std::nullopt);
  said_full_ = false;
}

void PageStore::set_spilled(std::vector<SpilledRange> ranges) {
  spilled_ = std::move(ranges);
  std::sort(spilled_.begin(), spilled_.end(), [](const SpilledRange& a, const SpilledRange& b) {
    return std::tie(a.frame_id, a.morton_first, a.id_first) < std::tie(b.frame_id, b.morton_first, b.id_first);
  });
}

}  // namespace splatbus::model
