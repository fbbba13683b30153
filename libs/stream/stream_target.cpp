// What is observed: which of it is read, and where it lies.

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "stream/bytes.h"
#include "stream/pieces.h"
#include "stream/stream_model.h"

namespace splatbus::stream {

bool StreamModel::observe(const GaussiansView& gaussians, const std::function<bool()>& still_valid) {
  if (gaussians.count > kMaxModelGaussians) {
    throw StreamError(fmt::format("model: {} Gaussians, at most {} can be read", gaussians.count, kMaxModelGaussians));
  }
  const bool another = !target_layout_ || !target_layout_->carries(gaussians.layout);
  if (origin_ && !StreamLayout(origin_->layout, origin_->mean_step).carries(gaussians.layout)) origin_.reset();
  const auto mean_step = [&] { return origin_ ? origin_->mean_step : quantizer_.choose_mean_step(gaussians); };
  const StreamLayout layout = another || !ready_ ? StreamLayout(gaussians.layout, mean_step()) : *target_layout_;
  const bool mirrored = ready_ && !another;
  Reading reading = ranges_to_read(gaussians, !mirrored);
  GaussiansView part = gaussians;
  if (gaussians.has_pages()) part.ranges = reading.ranges;
  const std::span<const std::uint64_t> ids = quantizer_.ids(part);
  reading.rows.assign(ids.size(), kNotHeld);
  if (mirrored) find_rows(reading, ids);
  quantizer_.quantize(part, layout, mirrored ? &held_.gaussians : nullptr, reading.rows);
  if (still_valid && !still_valid()) return false;

  if (another) set_ready(false);
  if (reading.rows.size() < read_.count() / 2) read_ = {};  // the first observation reads all
  quantizer_.commit(read_, read_usable_);
  if (target_layout_ != layout) {
    target_ = QuantizedGaussians(layout);
    known_.clear();
  }
  target_layout_ = layout;
  take_observed(reading);
  cut_target(gaussians, gaussians.has_pages() ? gaussians.ranges : reading.ranges);
  if (ready_) map_columns();
  return true;
}

// What is frozen stays as it is. A page that has thawed meanwhile, or is another one in the same place, says so by its
// generation.
StreamModel::Reading StreamModel::ranges_to_read(const GaussiansView& gaussians, bool all) {
  const std::uint32_t page_lanes = gaussians.has_pages() ? 1U << gaussians.page_shift : kPageLanes;
  if (page_lanes != std::exchange(page_lanes_, page_lanes)) known_.clear();
  Reading read;
  if (!gaussians.has_pages()) {
    const auto count = static_cast<std::uint32_t>(gaussians.count);
    for (std::uint32_t first = 0; first < count; first += kPageLanes) {
      read.ranges.push_back({.first = first, .count = std::min(kPageLanes, count - first)});
    }
    read.generations.resize(read.ranges.size());
    read.place();
    return read;
  }
  const bool says = gaussians.generations.size() == gaussians.ranges.size();
  for (std::size_t k = 0; k < gaussians.ranges.size(); ++k) {
    const IndexRange& range = gaussians.ranges[k];
    const std::uint64_t generation = says ? gaussians.generations[k] : 0;
    const std::uint32_t page = range.first / page_lanes_;
    const bool rests = !all && says && range.frozen != 0 && page < known_.size() && known_[page].range == range &&
                       known_[page].generation == generation;
    if (rests) continue;
    read.ranges.push_back(range);
    read.generations.push_back(generation);
  }
  read.place();
  return read;
}

void StreamModel::Reading::place() {
  std::size_t columns = 0;
  for (const IndexRange& range : ranges) {
    offsets.push_back(columns);
    columns += range.count;
  }
}

void StreamModel::find_rows(Reading& reading, std::span<const std::uint64_t> ids) const {
  for_each_at_once(reading.ranges.size(), [&](std::size_t k) {
    const IndexRange& range = reading.ranges[k];
    std::size_t i = reading.offsets[k];
    for (std::uint32_t column = range.first; column < range.first + range.count; ++column, ++i) {
      // Columns mostly stay where they were: look there first.
      const std::uint32_t before = column < row_of_column_.size() ? row_of_column_[column] : kNotHeld;
      const bool same = before < held_.rows() && ids[i] != 0 && held_.gaussians.gaussian_id[before] == ids[i];
      reading.rows[i] = same ? before : row_of(ids[i]);
    }
  });
}

StreamModel::KnownPage& StreamModel::known(std::uint32_t page) {
  if (page >= known_.size()) known_.resize(page + 1);
  return known_[page];
}

void StreamModel::take_observed(const Reading& reading) {
  std::size_t columns = 0;
  std::uint32_t pages = 0;
  for (const IndexRange& range : reading.ranges) {
    columns = std::max<std::size_t>(columns, range.first + range.count);
    pages = std::max(pages, range.first / page_lanes_ + 1);
  }
  if (pages > known_.size()) known_.resize(pages);
  if (columns > target_.count()) {
    target_.resize(columns + columns / 8);
    usable_.resize(target_.count());
    row_of_column_.resize(target_.count(), kNotHeld);
  }
  // Each range is of a page of its own.
  for_each_at_once(reading.ranges.size(), [&](std::size_t k) { take_range(reading, k); });
}

void StreamModel::take_range(const Reading& reading, std::size_t k) {
  const IndexRange& range = reading.ranges[k];
  const std::size_t from = reading.offsets[k];
  KnownPage& page = known_[range.first / page_lanes_];
  const bool same_place = page.range.first == range.first && page.range.frame_id == range.frame_id;
  const bool other_count = !same_place || page.range.count != range.count;
  if (!same_place) {
    vacate(page.range);
  } else if (page.range.count > range.count) {
    vacate({.first = range.first + range.count, .count = page.range.count - range.count});
  }
  const Difference difference = take_columns(range.first, range.count, from);
  const auto rows = reading.rows.begin() + static_cast<std::ptrdiff_t>(from), end = rows + range.count;
  const auto row_of_first = row_of_column_.begin() + range.first;
  if (difference.gaussians || other_count || !std::equal(rows, end, row_of_first)) page.settled = false;
  if (difference.gaussians || difference.values || other_count) {
    page.followed = false;
    page.idle_ticks = 0;
  }
  std::copy(rows, end, row_of_first);
  const auto first_usable = usable_.begin() + range.first;
  page.usable = static_cast<std::uint32_t>(std::count(first_usable, first_usable + range.count, 1));
  page.range = range;
  page.generation = reading.generations[k];
}

StreamModel::Difference StreamModel::take_columns(std::uint32_t first, std::uint32_t count, std::size_t from) {
  const auto take = [&](const auto& read, auto& target) {
    const auto begin = read.begin() + static_cast<std::ptrdiff_t>(from), end = begin + count;
    const auto to = target.begin() + first;
    if (std::equal(begin, end, to)) return false;
    std::copy(begin, end, to);
    return true;
  };
  Difference difference;
  for (std::size_t c = 0; c < target_.channels.size(); ++c) {
    difference.values |= take(read_.channels[c], target_.channels[c]);
  }
  difference.values |= take(read_.object_id, target_.object_id);
  difference.gaussians |= take(read_.gaussian_id, target_.gaussian_id);
  difference.gaussians |= take(read_usable_, usable_);
  return difference;
}

void StreamModel::vacate(const IndexRange& range) {
  const auto clear = [&](auto& values, auto nothing) {
    std::fill_n(values.begin() + range.first, range.count, nothing);
  };
  if (range.count == 0) return;
  for (auto& channel : target_.channels) clear(channel, 0);
  clear(target_.object_id, 0U);
  clear(target_.gaussian_id, std::uint64_t{0});
  clear(usable_, std::uint8_t{0});
  clear(row_of_column_, kNotHeld);
}

void StreamModel::cut_target(const GaussiansView& gaussians, std::span<const IndexRange> ranges) {
  const std::vector<TargetPage> before = std::exchange(target_pages_, {});
  for (const IndexRange& range : ranges) {
    target_pages_.push_back({.page = range.first / page_lanes_,
                             .first = range.first,
                             .count = range.count,
                             .object_id = range.frame_id,
                             .frozen = range.frozen != 0,
                             .bounds = {}});
  }
  observed_count_ = 0;
  for (std::size_t k = 0; k < target_pages_.size(); ++k) {
    TargetPage& page = target_pages_[k];
    observed_count_ += page.count;
    const bool said = gaussians.has_pages() && gaussians.bounds.size() == target_pages_.size();
    page.bounds = said ? gaussians.bounds[k] : bounds_of(target_, *target_layout_, page.first, page.count);
  }
  for (const TargetPage& page : before) {
    if (find_target(page.page) != nullptr) continue;
    vacate(known(page.page).range);
    known(page.page) = {};
  }
}

const StreamModel::TargetPage* StreamModel::find_target(std::uint32_t page) const {
  const auto found = std::ranges::lower_bound(target_pages_, page, {}, &TargetPage::page);
  return found != target_pages_.end() && found->page == page ? &*found : nullptr;
}

void StreamModel::index_blocks() {
  page_of_block_.assign(held_.rows() / kBlockRows, kNoPage);
  block_index_.assign(page_of_block_.size(), 0);
  for (const auto& [number, page] : held_.pages) {
    for (std::uint32_t k = 0; k < HeldPage::blocks_of(page.count); ++k) {
      page_of_block_[page.blocks[k]] = number;
      block_index_[page.blocks[k]] = k;
    }
  }
}

// Of pages that are settled everything stays.
void StreamModel::map_columns() {
  const std::vector<std::uint32_t> before = std::exchange(page_of_block_, {});
  index_blocks();
  column_of_row_.resize(held_.rows(), kNotHeld);
  target_page_of_row_.resize(held_.rows(), kNoPage);
  for (std::uint32_t block = 0; block < page_of_block_.size(); ++block) {
    const std::uint32_t page = page_of_block_[block];
    if (page != kNoPage && is_settled(page) && block < before.size() && before[block] == page) continue;
    const std::size_t first = std::size_t{block} * kBlockRows;
    std::fill_n(column_of_row_.data() + first, kBlockRows, kNotHeld);
    std::fill_n(target_page_of_row_.data() + first, kBlockRows, kNoPage);
  }
  for (const TargetPage& page : target_pages_) {
    if (!is_settled(page.page)) map_page(page);
  }
}

// An id that comes twice is a mistake of the publisher's; the first one counts. Of a page that was not read the rows
// may have become another's since.
void StreamModel::map_page(const TargetPage& page) {
  for (std::uint32_t column = page.first; column < page.first + page.count; ++column) {
    std::uint32_t& row = row_of_column_[column];
    const std::uint64_t id = target_.gaussian_id[column];
    if (row == kNotHeld || held_.gaussians.gaussian_id[row] != id) row = row_of(id);
    if (row == kNotHeld || target_page_of_row_[row] != kNoPage) continue;
    target_page_of_row_[row] = page.page;
    if (usable_[column]) column_of_row_[row] = column;
  }
}

}  // namespace splatbus::stream
