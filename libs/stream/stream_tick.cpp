// A tick: what comes and goes, values, what nobody holds, and what is offered then.

#include <algorithm>
#include <cassert>
#include <utility>

#include "stream/stream_model.h"

namespace splatbus::stream {

namespace {

constexpr std::size_t kFollowedPages = 64;  // that nobody holds and that have changed, a tick
constexpr std::size_t kLookedAtPages = 256;
constexpr std::size_t kRoom = 2 * kMaxGaussians;  // what moves may be in two pages for a moment

}  // namespace

// What is held takes the packet as a viewer does, from its bytes.
Change StreamModel::emit(EncodedPacket packet, std::vector<DeltaPacket::Step> steps, std::vector<PageVersion> gone) {
  const std::scoped_lock lock(mutex_);
  ++version_;
  Change change = apply(held_, ParsedPacket::parse(packet.packet, packet.payload), kRoom);
  assert(change.lacks.empty());
  if (!change.declined.empty()) throw StreamError("model: no room for what is published");
  tick_bytes_ += static_cast<double>(packet.bytes());
  update_.deltas.push_back({std::move(packet), std::move(steps), std::move(gone)});
  return change;
}

double StreamModel::make_tick(double budget_bytes, std::span<const Camera> viewers) {
  assert(ready_);
  ObjectTransforms objects;
  {
    const std::scoped_lock lock(mutex_);
    objects = held_.scene.objects;
    holders_now_ = holders_;
    if (holders_now_) holders_now_->insert(asked_.begin(), asked_.end());
  }
  tick_bytes_ = 0;
  try {
    tick_structure(budget_bytes, viewers, objects);
    tick_values(budget_bytes - tick_bytes_, viewers, objects);
    follow_unheld();
    offer();
  } catch (...) {
    set_ready(false);  // what is kept of the rows may lag behind them
    throw;
  }
  return tick_bytes_;
}

// What they see of the lights stays: relight says it, not the model.
void StreamModel::follow_unheld() {
  std::size_t followed = 0, looked_at = 0;
  const std::size_t count = target_pages_.size();
  const AttributeChannels* sun = held_.layout.find(Attribute::Visibility);
  for (std::size_t k = 0; k < count && followed < kFollowedPages && looked_at < kLookedAtPages; ++k) {
    const TargetPage& target = target_pages_[follow_next_++ % count];
    if (anybody_holds(target.page) || !held_.find(target.page) || known(target.page).followed) continue;
    ++looked_at;
    std::vector<std::uint32_t> columns;
    for (std::uint32_t column = target.first; column < target.first + target.count; ++column) {
      const std::uint32_t row = row_of_column_[column];
      if (row != kNotHeld && usable_[column] && page_of_row(row) == target.page) columns.push_back(column);
    }
    const QuantizedGaussians now = rounded(columns);
    bool differs = false;
    const std::scoped_lock lock(mutex_);
    if (asked_.contains(target.page)) continue;
    for (std::size_t i = 0; i < columns.size(); ++i) {
      const std::uint32_t column = columns[i], row = row_of_column_[column];
      for (std::size_t c = 0; c < now.channels.size(); ++c) {
        if (sun && c == static_cast<std::size_t>(sun->first)) continue;
        differs |= held_.gaussians.channels[c][row] != now.channels[c][i];
        held_.gaussians.channels[c].set(row, now.channels[c][i]);
      }
      differs |= held_.gaussians.object_id[row] != target_.object_id[column];
      held_.gaussians.object_id.set(row, target_.object_id[column]);
      selection_.begin(row, held_.gaussians);
    }
    known(target.page).followed = true;
    if (!differs) continue;
    held_.pages.at(target.page).version = ++version_;
    ++followed;
  }
}

void StreamModel::offer() {
  auto offered = std::make_shared<std::vector<OfferedPage>>();
  const std::scoped_lock lock(mutex_);
  for (const TargetPage& target : target_pages_) {
    const auto found = held_.pages.find(target.page);
    if (found == held_.pages.end()) continue;
    HeldPage& page = found->second;
    QuietPage& quiet = quiet_[target.page];
    // What rests is sent to within a step; twice as long, and nothing more will come.
    page.frozen = target.frozen && (quiet.ticks > 2 * options_.calm_ticks || !anybody_holds(target.page));
    // What is trained moves little: the points of its Gaussians stand for it until they become others.
    const auto before = std::ranges::lower_bound(*offered_, target.page, {}, &OfferedPage::page);
    const bool same = offered_epoch_ == held_.epoch && before != offered_->end() && before->page == target.page &&
                      before->structure == page.structure;
    offered->push_back(
        {.page = target.page,
         .version = page.version,
         .structure = page.structure,
         .count = page.count,
         .object_id = target.object_id,
         .level = page.level,
         .frozen = page.frozen,
         .bounds = target.bounds,
         .surfels = same ? before->surfels : std::make_shared<const PageSurfels>(surfels_of(held_, page))});
  }
  std::ranges::sort(*offered, {}, &OfferedPage::page);
  offered_ = std::move(offered);
  offered_epoch_ = held_.epoch;
}

}  // namespace splatbus::stream
