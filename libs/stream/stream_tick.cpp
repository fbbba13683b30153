#include <algorithm>
#include <array>
#include <cassert>
#include <numeric>

#include "stream/codecs.h"
#include "stream/delta_selection.h"
#include "stream/stream_model.h"

namespace splatbus::stream {

namespace {

// A packet's worth: large enough that its tables pay, small enough that a slow viewer can be sent some of them.
constexpr double kPacketBytes = 12'000;
constexpr std::size_t kPacketPages = 64;
constexpr std::size_t kPacketAppends = 2048;
constexpr double kAppendShare = 0.8;  // of the budget, while deltas wait
constexpr float kAbsentSteps = 640;   // that a Gaussian which is not there is off
constexpr double kObjectBytes = 2;
constexpr std::size_t kFollowedPages = 64;        // that nobody holds, a tick
constexpr std::size_t kRoom = 2 * kMaxGaussians;  // what moves may be in two pages for a moment
constexpr std::size_t kIdsPerGaussian = 2;        // that may be remembered

/// Of the sections of a packet.
template <class T>
void append(Bytes& payload, const T& part) {
  payload.insert(payload.end(), part.begin(), part.end());
}

}  // namespace

/// What of a page's values is to be sent, by index of the attribute; lanes ascend.
struct StreamModel::PageValues {
  std::uint32_t page = 0;
  std::uint64_t place = 0;
  double bytes = 0;
  float steps = 0;
  std::vector<std::vector<std::uint32_t>> lanes;  ///< [attributes]
  std::vector<std::uint32_t> objects;             ///< lanes that are another object's now
};

// What is held takes the packet as a viewer does, from its bytes.
Change StreamModel::emit(EncodedPacket packet, std::vector<DeltaPacket::Step> steps, std::vector<PageVersion> gone) {
  const std::scoped_lock lock(mutex_);
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

void StreamModel::tick_structure(double budget_bytes, std::span<const Camera> viewers,
                                 const ObjectTransforms& objects) {
  std::vector<PagePlan> plans = plan_pages();
  const double left = selection_.pending() > 0 ? kAppendShare * budget_bytes : budget_bytes;
  hold_back(plans, left, viewers, objects);

  std::set<std::uint32_t> in_target;
  std::map<std::uint32_t, std::vector<PagePlan*>> families;  // by base
  std::vector<const TargetPage*> whole;
  for (PagePlan& plan : plans) {
    in_target.insert(plan.target->page);
    if (!plan.changes()) continue;
    if (plan.base != kNoPage && anybody_holds(plan.base)) {
      families[plan.base].push_back(&plan);
    } else {
      whole.push_back(plan.target);
    }
  }
  std::vector<std::uint32_t> gone;
  for (const auto& [number, page] : held_.pages) {
    if (!in_target.contains(number)) gone.push_back(number);
  }

  std::vector<std::pair<std::uint64_t, std::uint32_t>> order;
  for (const auto& [base, family] : families) order.emplace_back(place_of(family.front()->target->page), base);
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
    for (const PagePlan* plan : families[base]) more += plan->moved.size() + plan->fresh.size();
    if (!packet.empty() && (appends + more > kPacketAppends || packet.size() >= kPacketPages)) flush();
    for (PagePlan* plan : families[base]) packet.push_back(std::move(*plan));
    if (!in_target.contains(base)) ended.push_back(base);
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
  const auto usable = static_cast<std::size_t>(std::ranges::count(usable_, 1));
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
  const HeldPage& page = *held_.find(plan.target->page);
  std::uint32_t lane = left;
  for (const std::vector<std::uint32_t>* columns : {&plan.moved, &plan.fresh}) {
    for (const std::uint32_t column : *columns) {
      const std::uint32_t row = page.row(lane++);
      held_.gaussians.gaussian_id[row] = target_.gaussian_id[column];
      row_of_id_[target_.gaussian_id[column]] = row;
      row_of_column_[column] = row;
      selection_.begin(row, held_.gaussians);
    }
  }
}

void StreamModel::emit_structure(std::span<const PagePlan> plans, std::span<const std::uint32_t> ended) {
  const std::uint32_t version = ++version_;
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
    QuantizedGaussians appended = target_.gather(columns);
    const AttributeChannels* sun = held_.layout.find(Attribute::Visibility);
    for (std::size_t i = 0; sun && i < columns.size(); ++i) {
      const std::uint32_t row = row_of_column_[columns[i]];  // of what moves relight has spoken
      if (row != kNotHeld) appended.channels[sun->first][i] = held_.gaussians.channels[sun->first][row];
    }
    blob = encode_page(appended, held_.layout, options_.codec, {.ids = false, .keep_order = true}).bytes;
    append(payload, blob);
    appended_bytes_ += 0.5 * (static_cast<double>(blob.size()) / static_cast<double>(columns.size()) - appended_bytes_);
  }
  const wire::Section removed_section(static_cast<std::uint32_t>(slots.size()), removed.raw_bytes,
                                      static_cast<std::uint32_t>(removed.bytes.size()));
  const wire::Section appended_section(static_cast<std::uint32_t>(columns.size()), 0,
                                       static_cast<std::uint32_t>(blob.size()));
  std::vector<wire::PageVersion> ends;
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

void StreamModel::tick_values(double budget_bytes, std::span<const Camera> viewers, const ObjectTransforms& objects) {
  if (budget_bytes <= 0) return;
  // Of pages that nobody holds nothing is to be sent.
  for (const auto& [number, page] : held_.pages) {
    if (anybody_holds(number)) continue;
    for (std::uint32_t lane = 0; lane < page.count; ++lane) column_of_row_[page.row(lane)] = kNotHeld;
  }
  const auto share = picture_share(held_.gaussians, held_.layout, viewers, objects);
  const auto selected = selection_.select(held_.gaussians, target_, column_of_row_, share, budget_bytes);

  std::map<std::uint32_t, PageValues> pages;
  const auto& attributes = held_.layout.attributes();
  for (const SelectedRows& rows : selected) {
    const auto a = static_cast<std::size_t>(held_.layout.find(rows.attribute) - attributes.data());
    const double bytes = selection_.bytes_per_entry(rows.attribute);
    for (std::size_t i = 0; i < rows.rows.size(); ++i) {
      PageValues& page = pages[page_of_row(rows.rows[i])];
      page.lanes.resize(attributes.size());
      page.lanes[a].push_back(lane_of_row(rows.rows[i]));
      page.bytes += bytes;
      page.steps += rows.steps[i];
    }
  }
  for (std::uint32_t row = 0; row < column_of_row_.size(); ++row) {
    const std::uint32_t column = column_of_row_[row];
    if (column == kNotHeld || target_.object_id[column] == held_.gaussians.object_id[row]) continue;
    PageValues& page = pages[page_of_row(row)];
    page.lanes.resize(attributes.size());
    page.objects.push_back(lane_of_row(row));
    page.bytes += kObjectBytes;
    page.steps += kAbsentSteps;
  }
  for (auto& [number, quiet] : quiet_) ++quiet.ticks;
  for (const std::uint32_t row : selection_.left_rows()) quiet_[page_of_row(row)].ticks = 0;
  std::vector<PageValues> order;
  for (auto& [number, page] : pages) {
    quiet_[number].ticks = 0;
    page.page = number;
    page.place = place_of(number);
    page.steps /= static_cast<float>(held_.find(number)->count);
    for (auto& lanes : page.lanes) std::ranges::sort(lanes);
    std::ranges::sort(page.objects);
    order.push_back(std::move(page));
  }
  std::ranges::sort(order, {}, &PageValues::place);
  std::size_t first = 0;
  double bytes = 0;
  for (std::size_t k = 0; k < order.size(); ++k) {
    if (k > first && (bytes + order[k].bytes > kPacketBytes || k - first >= kPacketPages)) {
      emit_values(std::span(order).subspan(first, k - first));
      first = k;
      bytes = 0;
    }
    bytes += order[k].bytes;
  }
  if (first < order.size()) emit_values(std::span(order).subspan(first));
}

void StreamModel::emit_values(std::span<const PageValues> pages) {
  const std::uint32_t version = ++version_;
  std::vector<wire::PageStep> steps;
  std::vector<DeltaPacket::Step> infos;
  for (const PageValues& values : pages) {
    const HeldPage& page = *held_.find(values.page);
    steps.emplace_back(values.page, values.page, page.version, version, page.count, 0, 0);
    infos.push_back({.page = values.page,
                     .base = values.page,
                     .from_version = page.version,
                     .version = version,
                     .count = page.count,
                     .other_lanes = false,
                     .steps = values.steps});
  }
  Bytes payload;
  SlotIds objects;
  std::uint32_t lanes = 0;
  for (const PageValues& values : pages) {
    const HeldPage& page = *held_.find(values.page);
    for (const std::uint32_t lane : values.objects) {
      objects.slots.push_back(lanes + lane);
      objects.ids.push_back(target_.object_id[column_of_row_[page.row(lane)]]);
    }
    lanes += page.count;
  }
  const Payload changed = objects.slots.empty() ? Payload{} : encode_slot_ids(objects);
  append(payload, changed.bytes);
  const wire::Section changed_section(static_cast<std::uint32_t>(objects.slots.size()), changed.raw_bytes,
                                      static_cast<std::uint32_t>(changed.bytes.size()));
  std::vector<wire::ValueSection> sections;
  const auto& attributes = held_.layout.attributes();
  for (std::size_t a = 0; a < attributes.size(); ++a) {
    const AttributeChannels& channels = attributes[a];
    Delta delta;
    std::vector<std::uint32_t> rows;
    std::uint32_t first = 0;
    for (const PageValues& values : pages) {
      const HeldPage& page = *held_.find(values.page);
      for (const std::uint32_t lane : values.lanes[a]) {
        delta.slots.push_back(first + lane);
        rows.push_back(page.row(lane));
      }
      first += page.count;
    }
    if (rows.empty()) continue;
    for (int c = channels.first; c < channels.first + channels.channels; ++c) {
      auto& plane = delta.residuals.emplace_back();
      for (const std::uint32_t row : rows) {
        plane.push_back(target_.channels[c][column_of_row_[row]] - held_.gaussians.channels[c][row]);
      }
    }
    const Payload encoded = encode_delta(delta);
    sections.emplace_back(channels.attribute, static_cast<std::uint32_t>(rows.size()), encoded.raw_bytes,
                          static_cast<std::uint32_t>(encoded.bytes.size()));
    append(payload, encoded.bytes);
    selection_.learn_cost(channels.attribute, rows.size(), encoded.bytes.size());
  }
  EncodedPacket packet = writer_.write(
      held_.epoch, 0, wire::Body::PageDelta,
      [&](auto& builder) {
        const auto steps_at = builder.CreateVectorOfStructs(steps);
        const auto values_at = builder.CreateVectorOfStructs(sections);
        return wire::CreatePageDelta(builder, steps_at, 0, nullptr, 0, nullptr,
                                     objects.slots.empty() ? nullptr : &changed_section, values_at);
      },
      std::move(payload));
  (void)emit(std::move(packet), std::move(infos), {});
}

// What they see of the lights stays: relight says it, not the model.
void StreamModel::follow_unheld() {
  std::size_t followed = 0;
  const std::size_t count = target_pages_.size();
  const AttributeChannels* sun = held_.layout.find(Attribute::Visibility);
  for (std::size_t k = 0; k < count && followed < kFollowedPages; ++k) {
    const TargetPage& target = target_pages_[follow_next_++ % count];
    if (anybody_holds(target.page) || !held_.find(target.page)) continue;
    const std::scoped_lock lock(mutex_);
    if (asked_.contains(target.page)) continue;
    bool differs = false;
    for (std::uint32_t column = target.first; column < target.first + target.count; ++column) {
      const std::uint32_t row = row_of_column_[column];
      if (row == kNotHeld || !usable_[column] || page_of_row(row) != target.page) continue;
      for (std::size_t c = 0; c < target_.channels.size(); ++c) {
        if (sun && c == static_cast<std::size_t>(sun->first)) continue;
        differs |=
            std::exchange(held_.gaussians.channels[c][row], target_.channels[c][column]) != target_.channels[c][column];
      }
      differs |= std::exchange(held_.gaussians.object_id[row], target_.object_id[column]) != target_.object_id[column];
      selection_.begin(row, held_.gaussians);
    }
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
    offered->push_back({.page = target.page,
                        .version = page.version,
                        .structure = page.structure,
                        .count = page.count,
                        .object_id = target.object_id,
                        .level = page.level,
                        .frozen = page.frozen,
                        .bounds = target.bounds});
  }
  std::ranges::sort(*offered, {}, &OfferedPage::page);
  offered_ = std::move(offered);
}

}  // namespace splatbus::stream
