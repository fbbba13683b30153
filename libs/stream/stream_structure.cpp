// What comes and goes of a tick: pages, and Gaussians of pages.

#include <algorithm>
#include <functional>
#include <utility>

#include "stream/codecs.h"
#include "stream/delta_selection.h"
#include "stream/stream_model.h"

namespace splatbus::stream {

namespace {

constexpr std::size_t kPacketAppends = 2048;
constexpr double kAppendShare = 0.8;        // of the budget, while deltas wait
constexpr std::size_t kIdsPerGaussian = 2;  // that may be remembered
constexpr std::size_t kWorthABase = 32;     // Gaussians; fewer are sent anew with their page

}  // namespace

std::uint32_t StreamModel::base_of(const TargetPage& page, const std::map<std::uint32_t, std::size_t>& shares) const {
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

StreamModel::PagePlan StreamModel::plan_page(const TargetPage& page,
                                             std::unordered_set<std::uint64_t>& fresh_ids) const {
  PagePlan plan{.target = &page, .base = kNoPage, .gone = {}, .moved = {}, .fresh = {}};
  std::map<std::uint32_t, std::size_t> from;                  // Gaussians, by the page that has them
  std::vector<std::pair<std::uint32_t, std::uint32_t>> rows;  // column, row
  std::size_t* share = nullptr;  // of the page before: neighbours mostly come from the same
  std::uint32_t share_of = kNoPage;
  for (std::uint32_t column = page.first; column < page.first + page.count; ++column) {
    const std::uint32_t row = row_of_column_[column];
    if (row != kNotHeld) {
      // Of several columns with one id the mapped one counts; where that is not usable, any other would not be either.
      const bool counts =
          target_page_of_row_[row] == page.page && (column_of_row_[row] == column || column_of_row_[row] == kNotHeld);
      plan.left_out |= !counts;
      if (!counts) continue;
      if (share == nullptr || share_of != page_of_row(row)) share = &from[share_of = page_of_row(row)];
      ++*share;
      rows.emplace_back(column, row);
    } else if (usable_[column]) {
      const bool is_first = fresh_ids.insert(target_.gaussian_id[column]).second;
      plan.left_out |= !is_first;
      if (is_first) plan.fresh.push_back(column);
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
  return plan;
}

/// Of pages that are not settled.
std::vector<StreamModel::PagePlan> StreamModel::plan_pages() {
  std::vector<PagePlan> plans;
  std::unordered_set<std::uint64_t> fresh_ids;
  for (const TargetPage& page : target_pages_) {
    KnownPage& known_page = known(page.page);
    if (known_page.settled) continue;
    plans.push_back(plan_page(page, fresh_ids));
    known_page.settled = !plans.back().changes() && !plans.back().left_out;
  }
  return plans;
}

bool StreamModel::Family::take(PagePlan& plan) {
  if (moved + plan.moved.size() > kMaxPageGaussians) return false;
  moved += plan.moved.size();
  plans.push_back(&plan);
  return true;
}

void StreamModel::Family::bound() {
  std::size_t room = kMaxPageGaussians - moved;
  for (PagePlan* plan : plans) {
    plan->fresh.resize(std::min(plan->fresh.size(), room));
    room -= plan->fresh.size();
  }
  std::erase_if(plans, [](const PagePlan* plan) { return !plan->changes(); });
}

void StreamModel::tick_structure(double budget_bytes, std::span<const Camera> viewers,
                                 const ObjectTransforms& objects) {
  std::vector<PagePlan> plans = plan_pages();
  const double left = selection_.pending() > 0 ? kAppendShare * budget_bytes : budget_bytes;
  hold_back(plans, left, viewers, objects);

  std::map<std::uint32_t, Family> families;  // by base
  std::vector<const TargetPage*> whole;
  for (PagePlan& plan : plans) {
    if (!plan.changes()) continue;
    const bool known = plan.base != kNoPage && anybody_holds(plan.base);
    if (known && families[plan.base].take(plan)) continue;
    whole.push_back(plan.target);
  }
  for (auto& [base, family] : families) family.bound();
  std::vector<std::uint32_t> gone;
  for (const auto& [number, page] : held_.pages) {
    if (!find_target(number)) gone.push_back(number);
  }

  std::vector<std::pair<std::uint64_t, std::uint32_t>> order;
  for (const auto& [base, family] : families)
    if (!family.plans.empty()) order.emplace_back(place_of(family.plans.front()->target->page), base);
  std::ranges::sort(order);
  std::vector<PagePlan> packet;
  std::vector<std::uint32_t> ended;
  std::size_t appends = 0;
  const auto flush = [&] {
    if (!packet.empty()) emit_structure(packet, ended);
    packet.clear();
    ended.clear();
    appends = 0;
  };
  for (const auto& [place, base] : order) {
    std::size_t more = 0;
    for (const PagePlan* plan : families[base].plans) more += plan->moved.size() + plan->fresh.size();
    if (!packet.empty() && (appends + more > kPacketAppends || packet.size() >= kPacketPages)) flush();
    for (PagePlan* plan : families[base].plans) packet.push_back(std::move(*plan));
    if (!find_target(base)) ended.push_back(base);
    appends += more;
  }
  flush();
  for (const TargetPage* page : whole) {
    if (!fill_page(*page) && held_.find(page->page)) drop_page(page->page);
  }
  for (const std::uint32_t page : gone) {
    if (held_.find(page)) drop_page(page);
  }
  if (row_of_id_.size() > kIdsPerGaussian * held_.count + kPageLanes) {
    std::erase_if(row_of_id_, [&](const auto& entry) { return row_of(entry.first) == kNotHeld; });
  }
  map_columns();
  std::size_t usable = 0;
  for (const TargetPage& page : target_pages_) usable += known(page.page).usable;
  unsent_ = usable - std::min(usable, held_.count);
  full_ = unsent_ > 0 && held_.count >= options_.max_gaussians;
}

// New Gaussians of pages that are held cost bytes, those that viewers see most come first. What has only moved to
// another page is not held back: it would be missing.
void StreamModel::hold_back(std::vector<PagePlan>& plans, double budget_bytes, std::span<const Camera> viewers,
                            const ObjectTransforms& objects) {
  std::size_t room = options_.max_gaussians - std::min(options_.max_gaussians, held_.count);
  std::vector<std::pair<double, PagePlan*>> order;
  for (PagePlan& plan : plans) {
    if (plan.fresh.empty() || plan.base == kNoPage || !anybody_holds(plan.base)) continue;
    plan.fresh = morton_order(target_, *target_layout_, plan.fresh);
    double sum = 0;
    for (const float share : picture_share(target_.gather(plan.fresh), held_.layout, viewers, objects)) sum += share;
    order.emplace_back(sum / static_cast<double>(plan.fresh.size()), &plan);
  }
  std::ranges::sort(order, std::greater<>{});
  double left = budget_bytes;
  bool first = true;
  for (const auto& [share, plan] : order) {
    const std::size_t held = held_.find(plan->base)->count - plan->gone.size() + plan->moved.size();
    const std::size_t lanes = std::min(kPageLanes - std::min<std::size_t>(kPageLanes, held), room);
    const double cost = static_cast<double>(plan->fresh.size()) * appended_bytes_;
    const bool goes = left > 0 && (first || cost <= left);
    const std::size_t count = goes ? std::min(plan->fresh.size(), lanes) : 0;
    if (goes) first = false;
    plan->fresh.resize(count);
    left -= static_cast<double>(count) * appended_bytes_;
    room -= count;
  }
}

void StreamModel::take_appended(const PagePlan& plan, std::uint32_t left) {
  const std::scoped_lock lock(mutex_);
  const HeldPage& page = *held_.find(plan.target->page);
  std::uint32_t lane = left;
  for (const std::vector<std::uint32_t>* columns : {&plan.moved, &plan.fresh}) {
    for (const std::uint32_t column : *columns) {
      const std::uint32_t row = page.row(lane++);
      held_.gaussians.gaussian_id.set(row, target_.gaussian_id[column]);
      row_of_id_[target_.gaussian_id[column]] = row;
      row_of_column_[column] = row;
      selection_.begin(row, held_.gaussians);
    }
  }
}

// Of a step they may come in any order: in that of the packet's blob they cost least.
void StreamModel::order_appended(std::span<PagePlan> plans) const {
  std::vector<std::uint32_t> columns;
  for (const PagePlan& plan : plans) {
    columns.insert(columns.end(), plan.moved.begin(), plan.moved.end());
    columns.insert(columns.end(), plan.fresh.begin(), plan.fresh.end());
  }
  const std::vector<std::uint32_t> order = page_order(rounded(columns), held_.layout, options_.codec);
  std::vector<std::uint32_t> place(order.size());
  for (std::uint32_t i = 0; i < order.size(); ++i) place[order[i]] = i;
  std::size_t at = 0;
  for (PagePlan& plan : plans) {
    for (std::vector<std::uint32_t>* part : {&plan.moved, &plan.fresh}) {
      std::vector<std::pair<std::uint32_t, std::uint32_t>> sorted;
      for (const std::uint32_t column : *part) sorted.emplace_back(place[at++], column);
      std::ranges::sort(sorted);
      for (std::size_t i = 0; i < sorted.size(); ++i) (*part)[i] = sorted[i].second;
    }
  }
}

void StreamModel::emit_structure(std::span<PagePlan> plans, std::span<const std::uint32_t> ended) {
  order_appended(plans);
  const std::uint32_t version = version_ + 1;
  std::vector<wire::PageStep> steps;
  std::vector<DeltaPacket::Step> infos;
  std::vector<std::uint32_t> slots, columns, lefts;
  std::vector<PageVersion> gone;
  std::uint32_t first = 0;
  for (const std::uint32_t page : ended) gone.push_back({page, held_.find(page)->version});
  for (const PagePlan& plan : plans) {
    const HeldPage& base = *held_.find(plan.base);
    const auto removed = static_cast<std::uint32_t>(plan.gone.size());
    const auto appended = static_cast<std::uint32_t>(plan.moved.size() + plan.fresh.size());
    const std::uint32_t left = base.count - removed;
    if (left + appended == 0) {  // nothing of it can be read
      gone.push_back({plan.base, base.version});
      continue;
    }
    steps.emplace_back(plan.target->page, plan.base, base.version, version, base.count, removed, appended);
    infos.push_back(
        {.page = plan.target->page,
         .base = plan.base,
         .from_version = base.version,
         .version = version,
         .count = left + appended,
         .other_lanes = true,
         .steps = kAbsentSteps * static_cast<float>(removed + appended) / static_cast<float>(base.count + appended)});
    for (const std::uint32_t lane : plan.gone) slots.push_back(first + lane);
    first += base.count;
    lefts.push_back(left);
    columns.insert(columns.end(), plan.moved.begin(), plan.moved.end());
    columns.insert(columns.end(), plan.fresh.begin(), plan.fresh.end());
  }
  Bytes payload;
  const Payload removed = slots.empty() ? Payload{} : encode_slots(slots);
  append(payload, removed.bytes);
  Bytes blob;
  if (!columns.empty()) {
    QuantizedGaussians appended = rounded(columns);
    const AttributeChannels* sun = held_.layout.find(Attribute::Visibility);
    for (std::size_t i = 0; sun && i < columns.size(); ++i) {
      const std::uint32_t row = row_of_column_[columns[i]];  // of what moves relight has spoken
      if (row != kNotHeld) appended.channels[sun->first][i] = held_.gaussians.channels[sun->first][row];
    }
    blob = encode_page(appended, held_.layout, options_.codec, {.ids = false, .keep_order = true, .origin = {}}).bytes;
    append(payload, blob);
    const double bytes = static_cast<double>(blob.size()) / static_cast<double>(columns.size());
    const std::scoped_lock lock(mutex_);
    appended_bytes_ += 0.5 * (bytes - appended_bytes_);
  }
  const wire::Section removed_section(static_cast<std::uint32_t>(slots.size()), removed.raw_bytes,
                                      static_cast<std::uint32_t>(removed.bytes.size()));
  const wire::Section appended_section(static_cast<std::uint32_t>(columns.size()), 0,
                                       static_cast<std::uint32_t>(blob.size()));
  std::vector<wire::PageVersion> ends;
  ends.reserve(gone.size());
  for (const PageVersion& end : gone) ends.emplace_back(end.page, end.version);
  EncodedPacket packet = writer_.write(
      held_.epoch, 0, wire::Body::PageDelta,
      [&](auto& builder) {
        const auto steps_at = builder.CreateVectorOfStructs(steps);
        const auto gone_at = builder.CreateVectorOfStructs(ends);
        return wire::CreatePageDelta(builder, steps_at, gone_at, &removed_section,
                                     static_cast<std::uint8_t>(options_.codec), &appended_section);
      },
      std::move(payload));
  const Change change = emit(std::move(packet), infos, gone);
  selection_.resize(held_.rows());
  for (const Change::Move& move : change.moves) {
    row_of_id_[held_.gaussians.gaussian_id[move.to]] = move.to;
    selection_.move(move.from, move.to);
  }
  std::size_t k = 0;
  for (const PagePlan& plan : plans) {
    if (k < infos.size() && infos[k].page == plan.target->page) take_appended(plan, lefts[k++]);
  }
  for (const PageVersion& end : gone) quiet_.erase(end.page);
  // Columns of what has moved are looked up anew.
  for (const PagePlan& plan : plans) {
    for (std::uint32_t c = plan.target->first; c < plan.target->first + plan.target->count; ++c) {
      row_of_column_[c] = row_of(target_.gaussian_id[c]);
    }
  }
}

}  // namespace splatbus::stream
