#include "stream/stream_model.h"

#include <algorithm>
#include <cassert>
#include <unordered_set>
#include <utility>

#include "stream/codecs.h"

namespace splatbus::stream {

StreamModel::StreamModel(PacketWriter writer, std::uint64_t stream_epoch, const StreamOptions& options, Device device)
    : writer_(std::move(writer)),
      options_(options),
      quantizer_(device),
      selection_(StreamLayout{}, options_.schedules, options_.calm_ticks),
      precision_(StreamLayout{}, options_.coarseness),
      own_epoch_(stream_epoch) {
  held_.epoch = stream_epoch;
}

void StreamModel::join(const StreamOrigin& origin) {
  set_ready(false);
  origin_ = origin;
}

void StreamModel::raise_version(std::uint32_t version) {
  const std::scoped_lock lock(mutex_);
  version_ = std::max(version_, version);
}

void StreamModel::set_schedules(const Schedules& schedules) {
  options_.schedules = schedules;
  selection_.set_schedules(schedules);
  for (KnownPage& page : known_) page.idle_ticks = 0;
}

std::uint32_t StreamModel::row_of(std::uint64_t id) const {
  const auto found = row_of_id_.find(id);
  if (found == row_of_id_.end() || found->second >= held_.rows()) return kNotHeld;
  return held_.gaussians.gaussian_id[found->second] == id ? found->second : kNotHeld;
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
  const TargetPage* found = find_target(number);
  if (!found) return 0;
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
    // Versions of an epoch are never used again: where this one was left, and is joined anew, they go on.
    const bool same = origin_ && origin_->epoch == held_.epoch;
    version_ = std::max(same ? version_ : 0, origin_ ? origin_->version : 0);
    const std::uint64_t epoch = origin_ ? origin_->epoch : ++own_epoch_;
    origin_.reset();
    held_ = {};
    held_.epoch = epoch;
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
  column_of_row_.clear();
  target_page_of_row_.clear();
  page_of_block_.clear();
  for (KnownPage& page : known_) page.settled = page.followed = false, page.idle_ticks = 0;
  selection_ = DeltaSelection(held_.layout, options_.schedules, options_.calm_ticks, options_.coarseness);
  precision_ = Precision(held_.layout, options_.coarseness);
  map_columns();
  std::unordered_set<std::uint64_t> seen;
  for (const TargetPage& page : target_pages_) {
    for (std::uint32_t column = page.first; column < page.first + page.count; ++column) {
      if (!usable_[column] || seen.insert(target_.gaussian_id[column]).second) continue;
      usable_[column] = 0;
      --known(page.page).usable;
    }
  }
  for (const TargetPage& page : target_pages_) (void)fill_page(page);
  map_columns();
  offer();
  const std::scoped_lock lock(mutex_);
  ready_ = true;
}

}  // namespace splatbus::stream
