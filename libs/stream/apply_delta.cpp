#include <fmt/format.h>

#include <algorithm>
#include <set>
#include <utility>

#include "stream/bytes.h"
#include "stream/codecs.h"
#include "stream/page_codec.h"
#include "stream/replicated_state.h"

namespace splatbus::stream {

namespace {

/// A step, and where its lanes are among those of all steps.
struct Step {
  wire::PageStep said;
  bool fits = false;
  std::vector<std::uint32_t> gone;         ///< lanes of the base
  std::vector<std::uint32_t> source;       ///< [lanes that remain] rows
  std::uint32_t first_left = 0, left = 0;  ///< among the lanes that remain
  std::uint32_t first_appended = 0;
};

struct NewValues {
  Attribute attribute{};
  int first = 0, channels = 0;
  struct At {
    std::uint32_t step, lane;
  };
  std::vector<At> at;
  std::vector<std::vector<std::int32_t>> values;  ///< [channels][at]
};

struct NewObjects {
  std::vector<NewValues::At> at;
  std::vector<std::uint32_t> ids;
};

class DeltaReader {
 public:
  DeltaReader(const ReplicatedState& state, const wire::PageDelta& body, std::span<const std::uint8_t> payload)
      : state_(state), body_(body), parts_(payload, "PageDelta") {
    read_steps();
    read_removed();
    read_appended();
    read_objects();
    read_values();
    parts_.finish();
  }

  std::vector<Step> steps;
  QuantizedGaussians appended;
  NewObjects objects;
  std::vector<NewValues> values;

 private:
  void read_steps() {
    if (body_.steps()->size() > kMaxDeltaPages) {
      throw StreamError(
          fmt::format("PageDelta: {} pages, at most {} are possible", body_.steps()->size(), kMaxDeltaPages));
    }
    std::set<std::uint32_t> pages, bases;
    for (const wire::PageStep* said : *body_.steps()) {
      const std::uint32_t count = said->count(), removed = said->removed();
      if (said->page() >= kMaxPageNumber || said->version() <= said->from_version() || said->from_version() == 0 ||
          count > kPageLanes || removed > count || said->appended() > kPageLanes - (count - removed) ||
          count - removed + said->appended() == 0) {
        throw StreamError(fmt::format("PageDelta: page {} at version {} from {} at {}: {} Gaussians, less {}, and {}",
                                      said->page(), said->version(), said->base(), said->from_version(), count, removed,
                                      said->appended()));
      }
      if (!pages.insert(said->page()).second) {
        throw StreamError(fmt::format("PageDelta: page {} twice", said->page()));
      }
      bases.insert(said->base());
      Step step{.said = *said};
      const HeldPage* base = state_.find(said->base());
      step.fits = base && base->whole() && base->version == said->from_version();
      if (step.fits && base->count != count) {
        throw StreamError(
            fmt::format("PageDelta: page {} of {} Gaussians, {} are held", said->base(), count, base->count));
      }
      step.left = count - removed;
      step.first_left = left_;
      step.first_appended = appended_;
      all_ += count;
      left_ += step.left;
      removed_ += removed;
      appended_ += said->appended();
      steps.push_back(std::move(step));
    }
    for (const Step& step : steps) {
      if (step.said.base() != step.said.page() && bases.contains(step.said.page())) {
        throw StreamError(fmt::format("PageDelta: page {} is new, and a base", step.said.page()));
      }
    }
  }

  void require_count(const wire::Section* section, std::size_t count, const char* what) const {
    if ((section ? section->count() : 0) != count) {
      throw StreamError(
          fmt::format("PageDelta: {} {} where the steps have {}", section ? section->count() : 0, what, count));
    }
  }

  void read_removed() {
    require_count(body_.removed(), removed_, "removed");
    std::vector<std::uint32_t> slots;
    if (removed_ > 0) {
      slots = decode_slots(parts_.next(body_.removed()->bytes()), body_.removed()->raw_bytes(), removed_, all_);
    }
    std::size_t at = 0;
    std::uint32_t first = 0;
    for (Step& step : steps) {
      const std::uint32_t end = first + step.said.count();
      for (; at < slots.size() && slots[at] < end; ++at) step.gone.push_back(slots[at] - first);
      if (step.gone.size() != step.said.removed()) {
        throw StreamError(fmt::format("PageDelta: page {} loses {} Gaussians where {} were said", step.said.base(),
                                      step.gone.size(), step.said.removed()));
      }
      first = end;
      if (!step.fits) continue;
      step.source = lanes_after(step.said.count(), step.gone);
      const HeldPage& base = *state_.find(step.said.base());
      for (std::uint32_t& lane : step.source) lane = base.row(lane);
    }
  }

  void read_appended() {
    require_count(body_.appended(), appended_, "appended");
    if (appended_ == 0) return;
    if (!is_page_codec(body_.codec())) throw StreamError(fmt::format("PageDelta: codec {}", body_.codec()));
    appended = decode_page(parts_.next(body_.appended()->bytes()), state_.layout, static_cast<PageCodec>(body_.codec()),
                           appended_);
  }

  /// Of a slot over the lanes that remain; slots ascend from call to call.
  NewValues::At locate(std::uint32_t slot, std::uint32_t& step) const {
    while (slot >= steps[step].first_left + steps[step].left) ++step;
    return {step, slot - steps[step].first_left};
  }

  void read_objects() {
    if (!body_.objects() || body_.objects()->bytes() == 0) return;
    const SlotIds change = decode_slot_ids(parts_.next(body_.objects()->bytes()), body_.objects()->raw_bytes(),
                                           body_.objects()->count(), left_);
    std::uint32_t step = 0;
    for (std::size_t i = 0; i < change.slots.size(); ++i) {
      const NewValues::At at = locate(change.slots[i], step);
      if (!steps[at.step].fits) continue;
      objects.at.push_back(at);
      objects.ids.push_back(change.ids[i]);
    }
  }

  void read_values() {
    if (!body_.values()) return;
    std::set<Attribute> seen;
    for (const wire::ValueSection* section : *body_.values()) {
      const AttributeChannels* a = state_.layout.find(section->attribute());
      if (!a || !seen.insert(section->attribute()).second) {
        throw StreamError(fmt::format("PageDelta: attribute {} is not in this stream, or twice",
                                      static_cast<int>(section->attribute())));
      }
      const Delta delta = decode_delta(parts_.next(section->bytes()), section->raw_bytes(), section->count(),
                                       static_cast<std::size_t>(a->channels), left_);
      values.push_back(sums(*a, delta));
    }
  }

  NewValues sums(const AttributeChannels& a, const Delta& delta) const {
    NewValues out{.attribute = a.attribute, .first = a.first, .channels = a.channels, .at = {}, .values = {}};
    out.values.resize(static_cast<std::size_t>(a.channels));
    std::uint32_t step = 0;
    for (std::size_t i = 0; i < delta.slots.size(); ++i) {
      const NewValues::At at = locate(delta.slots[i], step);
      if (!steps[at.step].fits) continue;
      out.at.push_back(at);
      for (int c = 0; c < a.channels; ++c) {
        const std::int64_t held = state_.gaussians.channels[a.first + c][steps[at.step].source[at.lane]];
        const std::int64_t sum = held + delta.residuals[c][i];
        if (sum < a.minimum || sum > a.maximum) {
          throw StreamError(fmt::format("PageDelta: {} of lane {} of page {} would be {}",
                                        wire::EnumNameAttribute(a.attribute), at.lane, steps[at.step].said.page(),
                                        sum));
        }
        out.values[c].push_back(static_cast<std::int32_t>(sum));
      }
    }
    return out;
  }

  const ReplicatedState& state_;
  const wire::PageDelta& body_;
  PayloadParts parts_;
  std::uint32_t all_ = 0, left_ = 0, removed_ = 0, appended_ = 0;
};

bool has_room_for(const ReplicatedState& state, const DeltaReader& delta, std::size_t max_gaussians) {
  std::size_t gaussians = 0, blocks = 0;
  for (const Step& step : delta.steps) {
    if (!step.fits) continue;
    const std::uint32_t count = step.left + step.said.appended();
    const bool copies = step.said.base() != step.said.page();
    const std::uint32_t before = copies ? 0 : step.said.count();
    gaussians += count - std::min(count, before);
    blocks += HeldPage::blocks_of(count) - std::min(HeldPage::blocks_of(count), HeldPage::blocks_of(before));
  }
  return has_room(state, gaussians, blocks, max_gaussians);
}

/// The lanes that remain, in their rows; in a page of its own, before any base changes.
void take_lanes(ReplicatedState& state, Step& step, HeldPage& page, Change& change) {
  for (std::uint32_t lane = 0; lane < step.left; ++lane) {
    const std::uint32_t from = step.source[lane], to = page.row(lane);
    if (from == to) continue;
    state.move_row(from, to);
    change.moves.push_back({from, to});
    change.rows.push_back(to);
  }
}

void take_appended(ReplicatedState& state, const DeltaReader& delta, const Step& step, const HeldPage& page,
                   Change& change) {
  std::vector<std::uint32_t> rows(step.said.appended());
  for (std::uint32_t i = 0; i < rows.size(); ++i) rows[i] = page.row(step.left + i);
  state.gaussians.write(rows, delta.appended, step.first_appended);
  change.rows.insert(change.rows.end(), rows.begin(), rows.end());
  change.arrivals.insert(change.arrivals.end(), rows.begin(), rows.end());
}

void finish_step(ReplicatedState& state, const DeltaReader& delta, Step& step, HeldPage& page, Change& change) {
  const bool other_lanes = step.said.removed() > 0 || step.said.appended() > 0 || step.said.base() != step.said.page();
  take_appended(state, delta, step, page, change);
  page.version = step.said.version();
  if (other_lanes) page.structure = page.version;
  page.missing = page.others = 0;
  page.frozen = false;
  ReplicatedState::show(page, change);
  change.taken.push_back(step.said.page());
}

}  // namespace

Change apply_delta(ReplicatedState& state, const wire::PageDelta& body, std::span<const std::uint8_t> payload,
                   std::size_t max_gaussians) {
  DeltaReader delta(state, body, payload);
  Change change;
  if (!has_room_for(state, delta, max_gaussians)) {
    for (const Step& step : delta.steps) change.declined.push_back(step.said.page());
    return change;
  }
  for (Step& step : delta.steps) {
    const HeldPage* page = state.find(step.said.page());
    const bool newer = page && page->version >= step.said.version();
    if (!step.fits && !newer && (page || state.find(step.said.base()))) change.lacks.push_back(step.said.page());
  }
  // Copies first: their bases may change, or end, in the same packet.
  for (Step& step : delta.steps) {
    if (!step.fits || step.said.base() == step.said.page()) continue;
    state.drop(step.said.page(), change);
    HeldPage& page = state.pages[step.said.page()];
    page.level = state.pages.at(step.said.base()).level;
    state.set_count(page, step.left + step.said.appended(), change);
    take_lanes(state, step, page, change);
    finish_step(state, delta, step, page, change);
  }
  for (Step& step : delta.steps) {
    if (!step.fits || step.said.base() != step.said.page()) continue;
    HeldPage& page = state.pages.at(step.said.page());
    take_lanes(state, step, page, change);
    state.set_count(page, step.left, change);
    state.set_count(page, step.left + step.said.appended(), change);
    finish_step(state, delta, step, page, change);
  }
  const auto row_of = [&](const NewValues::At& at) {
    return state.pages.at(delta.steps[at.step].said.page()).row(at.lane);
  };
  for (const NewValues& values : delta.values) {
    Change::Values changed{values.attribute, {}};
    for (std::size_t i = 0; i < values.at.size(); ++i) {
      const std::uint32_t row = row_of(values.at[i]);
      changed.rows.push_back(row);
      for (int c = 0; c < values.channels; ++c)
        state.gaussians.channels[values.first + c].set(row, values.values[c][i]);
    }
    if (!changed.rows.empty()) change.values.push_back(std::move(changed));
  }
  for (std::size_t i = 0; i < delta.objects.at.size(); ++i) {
    const std::uint32_t row = row_of(delta.objects.at[i]);
    state.gaussians.object_id.set(row, delta.objects.ids[i]);
    change.objects.push_back(row);
  }
  if (body.gone()) {
    for (const wire::PageVersion* gone : *body.gone()) {
      const HeldPage* page = state.find(gone->page());
      if (page && page->version <= gone->version()) state.drop(gone->page(), change);
    }
  }
  if (!change.rows.empty()) {
    for (const auto& [id, row] : state.light_rows.all()) change.seen.push_back({id, change.rows});
  }
  return change;
}

}  // namespace splatbus::stream
