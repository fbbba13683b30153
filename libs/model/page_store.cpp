#include "model/page_store.h"

#include <algorithm>
#include <stdexcept>

#include "model/table_slot.h"
#include "wire/model_generated.h"

namespace splatbus::model {

namespace {

GaussiansView view_of(const PageMemory& memory, const ParameterLayout& layout, Channel parameters) {
  GaussiansView view{.layout = layout, .stride = kRowWords, .page_shift = kPageShift, .page_stride = memory.page_words};
  view.parameters = memory.value(rows_of(parameters, layout).first, 0);
  view.normal = memory.value(memory.normal, 0);
  view.surface_point = memory.value(memory.surface_point, 0);
  view.visibility = memory.value(memory.visibility, 0);
  view.gaussian_id = memory.wide(memory.gaussian_id, 0);
  return view;
}

}  // namespace

std::size_t PageStore::room() const {
  return options_.max_gaussians - std::min(options_.max_gaussians, count_);
}

GaussiansView PageStore::view() const {
  GaussiansView view = view_of(memory_, layout_, Channel::Parameters);
  view.count = ranges_.empty() ? 0 : ranges_.back().first + ranges_.back().count;
  view.ranges = ranges_;
  view.bounds = bounds_;
  return view;
}

GaussiansView PageStore::average_view() const {
  GaussiansView result = view();
  result.parameters = average();
  return result;
}

void PageStore::add_step(std::size_t views, double seconds) {
  PageTableHeader& header = table_.header();
  header.step += 1;
  header.views += views;
  header.optimizer_s += seconds;
}

std::vector<LaneRange> PageStore::unchanged_since(std::uint64_t generation, std::size_t count) const {
  std::vector<LaneRange> unchanged;
  for (const IndexRange& range : ranges_) {
    const PageEntry& entry = table_.entry(range.first >> kPageShift);
    const bool later = entry.generation.load(std::memory_order_relaxed) > 2 * generation;
    if (!later && range.first + range.count <= count) unchanged.push_back({range.first, range.count});
  }
  return unchanged;
}

void PageStore::set_visibility(const std::uint8_t* values, std::span<const LaneRange> pages) {
  if (!pages.empty()) write_visibility(stream_, memory_, values, pages);
}

void PageStore::bound(std::vector<PageChange>& changes) const {
  std::vector<LaneRange> lanes;
  std::vector<std::size_t> owner;
  for (std::size_t c = 0; c < changes.size(); ++c) {
    const LaneRange& fresh = changes[c].fresh;
    for (std::uint32_t first = 0; first < fresh.count; first += kTierLanes) {
      lanes.push_back({fresh.first + first, std::min(kTierLanes, fresh.count - first)});
      owner.push_back(c);
    }
  }
  if (lanes.empty()) return;
  const std::vector<PageBounds> bounds = bounds_of_lanes(stream_, memory_, lanes);
  for (std::size_t k = 0; k < bounds.size(); ++k) {
    PageBounds& whole = changes[owner[k]].bounds;
    const PageBounds& part = bounds[k];
    whole.low = {std::min(whole.low.x, part.low.x), std::min(whole.low.y, part.low.y),
                 std::min(whole.low.z, part.low.z)};
    whole.high = {std::max(whole.high.x, part.high.x), std::max(whole.high.y, part.high.y),
                  std::max(whole.high.z, part.high.z)};
    whole.max_scale_m = std::max(whole.max_scale_m, part.max_scale_m);
  }
}

void PageStore::refresh_bounds(float move_m, float growth) {
  std::vector<PageChange> pages;
  std::vector<std::size_t> place;
  for (std::size_t r = 0; r < ranges_.size(); ++r) {
    if (ranges_[r].frozen != 0) continue;  // bounded as it froze
    pages.push_back({.page = 0, .next = {}, .bounds = {}, .fresh = {ranges_[r].first, ranges_[r].count}});
    place.push_back(r);
  }
  bound(pages);
  const math::Vec3 move{move_m, move_m, move_m};
  for (std::size_t k = 0; k < pages.size(); ++k) {
    const PageBounds& now = pages[k].bounds;
    const std::size_t r = place[k];
    bounds_[r] = {now.low - move, now.high + move, now.max_scale_m * growth};
    table_.entry(ranges_[r].first >> kPageShift).bounds = bounds_[r];
  }
  device_bounds_.assign(bounds_);
  stream_.wait();
}

void PageStore::freeze(std::span<const std::uint32_t> pages) {
  std::vector<LaneRange> lanes;
  std::vector<PageChange> changes;
  for (const std::uint32_t page : pages) {
    const PageStructure& now = table_.entry(page).now;
    if (now.state != PageState::Active || now.count == 0) continue;
    lanes.push_back({page * kPageLanes, now.count});
    changes.push_back({.page = page, .next = now, .bounds = {}, .fresh = lanes.back()});
    changes.back().next.state = PageState::Frozen;
  }
  if (lanes.empty()) return;
  take_averages(stream_, memory_, static_cast<std::uint32_t>(layout_.channels()), lanes);
  bound(changes);
  apply(changes, next_gaussian_id(), std::nullopt);
}

void PageStore::thaw(std::span<const std::uint32_t> pages) {
  std::vector<PageChange> changes;
  for (const std::uint32_t page : pages) {
    const PageEntry& entry = table_.entry(page);
    if (entry.now.state != PageState::Frozen) continue;
    changes.push_back({.page = page, .next = entry.now, .bounds = entry.bounds, .fresh = {}});
    changes.back().next.state = PageState::Active;
  }
  if (!changes.empty()) apply(changes, next_gaussian_id(), std::nullopt);
}

void PageStore::refresh_ranges() {
  ranges_.clear();
  bounds_.clear();
  count_ = frozen_count_ = frozen_pages_ = 0;
  const auto pages = static_cast<std::uint32_t>(range_->slabs().size()) * kArenaPages;
  for (std::uint32_t page = 0; page < std::min(pages, table_.page_capacity()); ++page) {
    const PageEntry& entry = table_.entry(page);
    if (!is_present(entry.now.state) || entry.now.count == 0) continue;
    const bool frozen = entry.now.state == PageState::Frozen;
    ranges_.push_back({page * kPageLanes, entry.now.count, entry.now.frame_id, frozen ? 1U : 0U});
    bounds_.push_back(entry.bounds);
    count_ += entry.now.count;
    if (!frozen) continue;
    frozen_pages_ += 1;
    frozen_count_ += entry.now.count;
  }
  device_ranges_.assign(ranges_);
  device_bounds_.assign(bounds_);
  stream_.wait();
}

void PageStore::publish(const bus::Publisher& publisher) const {
  bus::MessageInfo info;
  const auto add = [&](const std::string& name, const bus::Slab& slab, std::vector<std::uint32_t> shape,
                       bus::ElementType type) {
    const std::size_t bytes = bus::tensor_bytes(shape, type);
    info.tensors.push_back({.name = name,
                            .shape = std::move(shape),
                            .type = type,
                            .span = slab.span(kSlot, 0, bytes, slab.sequence(kSlot))});
  };
  add("page_table", *table_slab_, {static_cast<std::uint32_t>(page_table_bytes(table_.page_capacity()))},
      bus::ElementType::U8);
  // Not all of the last arenas: over tcp what lies beyond the last page that holds something would be copied too.
  const std::uint32_t pages = ranges_.empty() ? 0 : (ranges_.back().first >> kPageShift) + 1;
  std::uint32_t arena = 0;
  for (const auto& slab : range_->slabs()) {
    const std::uint32_t before = arena * kArenaPages;
    const std::uint32_t here = std::clamp<std::uint32_t>(pages > before ? pages - before : 0, 1, kArenaPages);
    add("pages-" + std::to_string(arena++), *slab, {here, page_words(layout_)}, bus::ElementType::U32);
  }
  publisher.publish(
      topics::kModelPublished, info,
      [&](flatbuffers::FlatBufferBuilder& builder, flatbuffers::Offset<wire::Header> header) {
        const auto batches = builder.CreateVector(table_.batches());
        return wire::CreateModelPublished(
            builder, header, generation(), count_, table_.page_capacity(), arena,
            static_cast<std::uint32_t>(directory_.size()), kPageLanes, static_cast<std::uint32_t>(memory_.page_words),
            layout_.appearance == Appearance::Transfer ? wire::Appearance::Transfer : wire::Appearance::Radiance,
            static_cast<std::uint8_t>(layout_.sh_degree), step(), table_.header().insert_epoch, batches);
      });
}

}  // namespace splatbus::model
