#include "stream/stream_model.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <unordered_set>
#include <utility>

#include "stream/bytes.h"
#include "stream/codecs.h"

namespace splatbus::stream {

namespace {

constexpr std::size_t kWorthABase = 32;  // Gaussians; fewer are sent anew with their page

PageBounds bounds_of_columns(const QuantizedGaussians& gaussians, const StreamLayout& layout, std::uint32_t first,
                             std::uint32_t count) {
  const AttributeChannels &mean = layout.at(Attribute::Mean), &scale = layout.at(Attribute::LogScale);
  const auto value = [&](const AttributeChannels& a, int c, std::uint32_t i) {
    return a.quantizer.offset + a.quantizer.step * static_cast<float>(gaussians.channels[a.first + c][i]);
  };
  PageBounds bounds;
  for (std::uint32_t i = first; i < first + count; ++i) {
    include(bounds, {value(mean, 0, i), value(mean, 1, i), value(mean, 2, i)},
            std::max({value(scale, 0, i), value(scale, 1, i), value(scale, 2, i)}));
  }
  return bounds;
}

}  // namespace

StreamModel::StreamModel(PacketWriter writer, std::uint64_t stream_epoch, const StreamOptions& options, Device device)
    : writer_(std::move(writer)),
      options_(options),
      quantizer_(device),
      selection_(StreamLayout{}, options_.schedules, options_.calm_ticks),
      precision_(StreamLayout{}, options_.coarseness) {
  held_.epoch = stream_epoch;
}

void StreamModel::set_schedules(const Schedules& schedules) {
  options_.schedules = schedules;
  selection_.set_schedules(schedules);
}

std::uint32_t StreamModel::row_of(std::uint64_t id) const {
  const auto found = row_of_id_.find(id);
  if (found == row_of_id_.end() || found->second >= held_.rows()) return kNotHeld;
  return held_.gaussians.gaussian_id[found->second] == id ? found->second : kNotHeld;
}

bool StreamModel::observe(const GaussiansView& gaussians, const std::function<bool()>& still_valid) {
  if (gaussians.count > kMaxModelGaussians) {
    throw StreamError(fmt::format("model: {} Gaussians, at most {} can be read", gaussians.count, kMaxModelGaussians));
  }
  const bool another = !target_layout_ || !target_layout_->carries(gaussians.layout);
  const StreamLayout layout =
      another || !ready_ ? StreamLayout(gaussians.layout, quantizer_.choose_mean_step(gaussians)) : *target_layout_;
  const bool mirrored = ready_ && !another;
  const std::span<const std::uint64_t> ids = quantizer_.ids(gaussians);
  std::vector<std::uint32_t> rows(ids.size(), kNotHeld);
  for (std::size_t i = 0; mirrored && i < ids.size(); ++i) {
    // Columns mostly stay where they were: look there first.
    const std::uint32_t before = i < row_of_column_.size() ? row_of_column_[i] : kNotHeld;
    const bool same = before < held_.rows() && ids[i] != 0 && held_.gaussians.gaussian_id[before] == ids[i];
    rows[i] = same ? before : row_of(ids[i]);
  }
  quantizer_.quantize(gaussians, layout, mirrored ? &held_.gaussians : nullptr, rows);
  if (still_valid && !still_valid()) return false;

  if (another) set_ready(false);
  quantizer_.commit(target_, usable_);
  target_layout_ = layout;
  row_of_column_ = std::move(rows);
  cut_target(gaussians);
  if (ready_) map_columns();
  return true;
}

void StreamModel::cut_target(const GaussiansView& gaussians) {
  target_pages_.clear();
  const auto add = [&](std::uint32_t page, std::uint32_t first, const IndexRange& range) {
    target_pages_.push_back({.page = page,
                             .first = first,
                             .count = range.count,
                             .index = range.first,
                             .object_id = range.frame_id,
                             .frozen = range.frozen != 0,
                             .bounds = {}});
  };
  if (gaussians.has_pages()) {
    std::uint32_t first = 0;
    for (const IndexRange& range : gaussians.ranges) {
      add(range.first >> gaussians.page_shift, first, range);
      first += range.count;
    }
  } else {
    const auto count = static_cast<std::uint32_t>(gaussians.count);
    for (std::uint32_t first = 0; first < count; first += kPageLanes) {
      add(first / kPageLanes, first, {.first = first, .count = std::min(kPageLanes, count - first)});
    }
  }
  for (std::size_t k = 0; k < target_pages_.size(); ++k) {
    TargetPage& page = target_pages_[k];
    const bool known = gaussians.has_pages() && gaussians.bounds.size() == target_pages_.size();
    page.bounds = known ? gaussians.bounds[k] : bounds_of_columns(target_, *target_layout_, page.first, page.count);
  }
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

// An id that comes twice is a mistake of the publisher's; the first one counts.
void StreamModel::map_columns() {
  index_blocks();
  column_of_row_.assign(held_.rows(), kNotHeld);
  target_page_of_row_.assign(held_.rows(), kNoPage);
  for (const TargetPage& page : target_pages_) {
    for (std::uint32_t column = page.first; column < page.first + page.count; ++column) {
      const std::uint32_t row = row_of_column_[column];
      if (row == kNotHeld || target_page_of_row_[row] != kNoPage) continue;
      target_page_of_row_[row] = page.page;
      if (usable_[column]) column_of_row_[row] = column;
    }
  }
}

std::uint32_t StreamModel::base_of(const TargetPage& page, std::span<const std::uint32_t> from) const {
  std::map<std::uint32_t, std::size_t> shares;
  for (const std::uint32_t number : from) ++shares[number];
  if (shares.contains(page.page)) return page.page;
  // Elsewhere its number is that of a page whose Gaussians go: it has to be replaced as a whole.
  if (held_.find(page.page)) return kNoPage;
  std::uint32_t base = kNoPage;
  std::size_t most = kWorthABase;
  for (const auto& [number, share] : shares) {
    if (share >= most && anybody_holds(number)) {
      most = share;
      base = number;
    }
  }
  return base;
}

std::vector<StreamModel::PagePlan> StreamModel::plan_pages() {
  std::vector<PagePlan> plans;
  plans.reserve(target_pages_.size());
  std::unordered_set<std::uint64_t> seen;
  for (const TargetPage& page : target_pages_) {
    PagePlan plan{.target = &page, .base = kNoPage, .gone = {}, .moved = {}, .fresh = {}};
    std::vector<std::uint32_t> from;
    std::vector<std::pair<std::uint32_t, std::uint32_t>> rows;  // column, row
    for (std::uint32_t column = page.first; column < page.first + page.count; ++column) {
      const std::uint32_t row = row_of_column_[column];
      if (row != kNotHeld) {
        // Of several columns with one id the mapped one counts; where that is not usable, any other would not be
        // either.
        const bool counts =
            target_page_of_row_[row] == page.page && (column_of_row_[row] == column || column_of_row_[row] == kNotHeld);
        if (!counts) continue;
        from.push_back(page_of_row(row));
        rows.emplace_back(column, row);
      } else if (usable_[column] && seen.insert(target_.gaussian_id[column]).second) {
        plan.fresh.push_back(column);
      }
    }
    plan.base = base_of(page, from);
    for (const auto& [column, row] : rows) {
      if (page_of_row(row) != plan.base && usable_[column]) plan.moved.push_back(column);
    }
    if (plan.base != kNoPage) {
      const HeldPage& base = *held_.find(plan.base);
      for (std::uint32_t lane = 0; lane < base.count; ++lane) {
        if (target_page_of_row_[base.row(lane)] != page.page) plan.gone.push_back(lane);
      }
    }
    plans.push_back(std::move(plan));
  }
  return plans;
}

bool StreamModel::anybody_holds(std::uint32_t page) const {
  return !holders_now_ || holders_now_->contains(page);
}

void StreamModel::set_holders(std::set<std::uint32_t> pages) {
  const std::scoped_lock lock(mutex_);
  holders_ = std::move(pages);
  asked_.clear();
}

std::uint64_t StreamModel::place_of(std::uint32_t number) const {
  const auto found = std::ranges::lower_bound(target_pages_, number, {}, &TargetPage::page);
  if (found == target_pages_.end() || found->page != number) return 0;
  const auto spread = [](float low, float high) {
    auto v = static_cast<std::uint64_t>(std::clamp(0.5F * (low + high) * 2 + 8192, 0.0F, 16383.0F));
    std::uint64_t bits = 0;
    for (int k = 0; k < 14; ++k) bits |= (v >> k & 1U) << (3 * k);
    return bits;
  };
  const PageBounds& b = found->bounds;
  if (!(b.low.x <= b.high.x)) return 0;
  return spread(b.low.x, b.high.x) | spread(b.low.y, b.high.y) << 1 | spread(b.low.z, b.high.z) << 2;
}

QuantizedGaussians StreamModel::rounded(std::span<const std::uint32_t> columns) const {
  QuantizedGaussians out = target_.gather(columns);
  precision_.round(out);
  return out;
}

bool StreamModel::fill_page(const TargetPage& target) {
  std::vector<std::uint32_t> columns;
  for (std::uint32_t column = target.first; column < target.first + target.count; ++column) {
    const std::uint32_t row = row_of_column_[column];
    const bool first = row == kNotHeld || (target_page_of_row_[row] == target.page && column_of_row_[row] == column);
    if (usable_[column] && first) columns.push_back(column);
  }
  QuantizedGaussians lanes = rounded(columns);
  {
    const std::vector<std::uint32_t> order = page_order(lanes, held_.layout, options_.codec);
    lanes = lanes.gather(order);
    std::vector<std::uint32_t> unordered = std::exchange(columns, {});
    for (const std::uint32_t i : order) columns.push_back(unordered[i]);
  }
  const HeldPage* before = held_.find(target.page);
  const std::size_t held = before ? before->count : 0;
  const std::size_t room = options_.max_gaussians - std::min(options_.max_gaussians, held_.count - held);
  if (columns.size() > room) columns.resize(room);
  if (columns.empty()) return false;
  // What they see of the lights is known of those that are held already, in whichever page.
  const AttributeChannels* sun = held_.layout.find(Attribute::Visibility);
  std::vector<std::int32_t> sun_seen;
  std::map<std::uint32_t, Bytes> seen;
  const std::scoped_lock lock(mutex_);
  for (const std::uint32_t column : columns) {
    const std::uint32_t row = row_of_column_[column];
    if (sun)
      sun_seen.push_back(row != kNotHeld ? held_.gaussians.channels[sun->first][row]
                                         : target_.channels[sun->first][column]);
    for (const auto& [id, values] : held_.light_rows.all()) {
      seen[id].push_back(row != kNotHeld ? values[row] : std::uint8_t{255});
    }
  }
  Change change;
  HeldPage& page = held_.pages[target.page];
  held_.set_count(page, 0, change);
  held_.set_count(page, static_cast<std::uint32_t>(columns.size()), change);
  page.version = page.structure = ++version_;
  ReplicatedState::show(page, change);
  selection_.resize(held_.rows());
  column_of_row_.resize(held_.rows(), kNotHeld);
  for (std::uint32_t lane = 0; lane < page.count; ++lane) {
    const std::uint32_t row = page.row(lane), column = columns[lane];
    held_.gaussians.write({&row, 1}, lanes, lane);
    if (sun) held_.gaussians.channels[sun->first].set(row, sun_seen[lane]);
    for (const auto& [id, values] : seen) (*held_.light_rows.find(id))[row] = values[lane];
    held_.gaussians.gaussian_id.set(row, target_.gaussian_id[column]);
    row_of_id_[target_.gaussian_id[column]] = row;
    column_of_row_[row] = column;
    row_of_column_[column] = row;
    selection_.begin(row, held_.gaussians);
  }
  return true;
}

void StreamModel::drop_page(std::uint32_t page) {
  const std::scoped_lock lock(mutex_);
  Change change;
  held_.drop(page, change);
  update_.gone.push_back(page);
  blobs_.erase(page);
  quiet_.erase(page);
}

void StreamModel::reset_to_target() {
  assert(observed());
  {
    const std::scoped_lock lock(mutex_);
    const std::uint64_t epoch = held_.epoch + 1;
    held_ = {};
    held_.epoch = epoch;
    version_ = 0;
    held_.layout = *target_layout_;
    held_.gaussians = HeldGaussians(held_.layout);
    hold_scene();
    update_ = {};
    blobs_.clear();
    asked_.clear();
  }
  visibility_waits_.clear();
  quiet_.clear();
  row_of_id_.clear();
  row_of_column_.assign(target_.count(), kNotHeld);
  selection_ = DeltaSelection(held_.layout, options_.schedules, options_.calm_ticks, options_.coarseness);
  precision_ = Precision(held_.layout, options_.coarseness);
  map_columns();
  std::unordered_set<std::uint64_t> seen;
  for (std::uint32_t column = 0; column < target_.count(); ++column) {
    if (usable_[column] && !seen.insert(target_.gaussian_id[column]).second) usable_[column] = 0;
  }
  for (const TargetPage& page : target_pages_) (void)fill_page(page);
  map_columns();
  offer();
  const std::scoped_lock lock(mutex_);
  ready_ = true;
}

}  // namespace splatbus::stream
