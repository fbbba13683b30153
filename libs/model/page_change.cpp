// How a PageStore changes its structure: what goes where is planned on the host from a page's worth of numbers, and
// done where the pages lie.

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <glm/gtc/quaternion.hpp>

#include "model/page_store.h"

namespace splatbus::model {

namespace {

InsertLight insert_light(const Light& light) {
  InsertLight result{};
  for (int c = 0; c < 3; ++c) {
    for (std::size_t k = 0; k < light.ambient_sh.size(); ++k) {
      result.ambient_sh[3 * k + static_cast<std::size_t>(c)] = light.ambient_sh[k][c];
    }
    result.sun_direction[c] = light.sun_direction[c];
    result.sun_irradiance[c] = light.sun_irradiance[c];
  }
  return result;
}

std::vector<ObjectRotation> object_rotations(const ObjectTransforms& objects) {
  std::vector<ObjectRotation> rotations;
  rotations.reserve(objects.size());
  for (const auto& [id, world_from_object] : objects) {
    const glm::quat& q = world_from_object.rigid.rotation;
    rotations.push_back({.id = id, .w = q.w, .x = q.x, .y = q.y, .z = q.z, .emissive = world_from_object.emissive});
  }
  return rotations;
}

}  // namespace

/// An insertion. Pages that only take Gaussians in need an Append; what needs new pages is a Split, of no page at all
/// for a new frame of reference.
struct PageStore::Plan {
  std::vector<Page> directory;  ///< as it will be
  std::vector<Append> appends;
  std::vector<Split> splits;
  std::vector<std::uint32_t> new_pages;
  std::vector<std::size_t> new_at;  ///< where the new pages are in `directory`
  std::vector<PageChange> changes;
  std::uint32_t split_items = 0, moved = 0;
  std::uint32_t left_out = 0, known = 0;  ///< new ones for which there is no room; that are in a page that is spilled
};

std::uint32_t PageStore::taken(std::size_t count) {
  const std::size_t taken = std::min(count, room());
  if (taken < count && !said_full_) {
    said_full_ = true;
    spdlog::warn("model: full, {} of {} new Gaussians are left out (max_gaussians {}); later ones are without a word",
                 count - taken, count, options_.max_gaussians);
  }
  return static_cast<std::uint32_t>(taken);
}

std::uint32_t PageStore::fill_target() const {
  return std::max(1U, static_cast<std::uint32_t>(options_.fill * kPageLanes));
}

void PageStore::reserve_pages(std::size_t pages) {
  const std::uint32_t list = table_.header().arena_list;
  const std::size_t most = options_.max_pages > 0 ? std::min<std::size_t>(options_.max_pages, table_.page_capacity())
                                                  : table_.page_capacity();
  while (free_.size() < pages && range_->slabs().size() * kArenaPages < most) {
    add_arena(table_.header().arenas.at(list), list);
  }
}

bool PageStore::has_page() {
  if (free_.empty()) reserve_pages(1);
  return !free_.empty();
}

void PageStore::plan_split(Plan& plan, const Page& page, std::uint32_t first_item, std::uint32_t items,
                           std::uint32_t new_pages) {
  const std::uint32_t total = page.count + items;
  plan.appends.push_back({first_item, kNotInserted, items});
  plan.splits.push_back({.first = plan.split_items,
                         .old_index = page.page == kNoPage ? 0 : page.page * kPageLanes,
                         .old_count = page.count,
                         .first_item = first_item,
                         .item_count = items,
                         .first_new_page = static_cast<std::uint32_t>(plan.new_pages.size()),
                         .new_page_count = new_pages});
  plan.split_items += total;
  plan.moved += page.count;
  if (page.page != kNoPage) plan.changes.push_back({.page = page.page, .next = {}, .bounds = {}, .fresh = {}});
  for (std::uint64_t q = 0; q < new_pages; ++q) {
    Page fresh = page;
    fresh.page = free_.back();
    free_.pop_back();
    fresh.count = static_cast<std::uint32_t>((q + 1) * total / new_pages - q * total / new_pages);
    plan.new_pages.push_back(fresh.page);
    plan.new_at.push_back(plan.directory.size());
    plan.directory.push_back(fresh);
  }
}

void PageStore::plan_page(Plan& plan, const Page& page, std::uint32_t first_item, std::uint32_t items) {
  if (items == 0) {
    plan.directory.push_back(page);
    return;
  }
  const bool exists = page.page != kNoPage;
  if (!exists || page.count + items > kPageLanes) {
    const std::uint32_t target = fill_target();
    const std::uint32_t new_pages = (page.count + items + target - 1) / target;
    reserve_pages(new_pages);
    if (new_pages <= free_.size()) return plan_split(plan, page, first_item, items, new_pages);
  }
  // As it is: also when no pages are left to split it into, and then for as many as it has room for.
  const std::uint32_t room = exists ? std::min(items, kPageLanes - page.count) : 0;
  plan.left_out += items - room;
  plan.appends.push_back({first_item, exists ? page.page * kPageLanes + page.count : 0, room});
  if (!exists) return;
  Page fuller = page;
  fuller.count += room;
  plan.directory.push_back(fuller);
  plan.changes.push_back({.page = page.page,
                          .next = {.state = PageState::Active,
                                   .frame_id = page.frame_id,
                                   .count = fuller.count,
                                   .morton_first = page.morton,
                                   .id_first = page.id},
                          .bounds = table_.entry(page.page).bounds,
                          .fresh = {page.page * kPageLanes + page.count, room}});
}

void PageStore::begin_frames(std::vector<Page>& pages) const {
  const auto of_frame = [](const SpilledRange& range, std::uint32_t frame) { return range.frame_id < frame; };
  for (std::size_t p = 0; p < pages.size(); ++p) {
    Page& page = pages[p];
    if (p > 0 && page.frame_id == pages[p - 1].frame_id) continue;
    auto spilled = std::lower_bound(spilled_.begin(), spilled_.end(), page.frame_id, of_frame);
    if (spilled == spilled_.end() || spilled->frame_id != page.frame_id) {
      page.morton = page.id = 0;
    } else if (page.page == kNoPage) {
      // Its key is nobody's, also among those that may come back.
      for (page.morton = page.id = 0; spilled != spilled_.end() && spilled->frame_id == page.frame_id &&
                                      spilled->morton_first == 0 && spilled->id_first == page.id;
           ++spilled) {
        ++page.id;
      }
    }
  }
}

PageStore::Plan PageStore::place(std::uint32_t count, std::uint32_t rows) {
  sort_items(stream_, items_.data(), count);
  // The directory, and a place in it for each frame that has no page yet.
  std::vector<Page> pages;
  pages.reserve(directory_.size() + 16);
  auto next = directory_.begin();
  for (const std::uint32_t frame_id : list_groups(stream_, items_.data(), count)) {
    const auto from = std::lower_bound(next, directory_.end(), frame_id,
                                       [](const Page& page, std::uint32_t frame) { return page.frame_id < frame; });
    pages.insert(pages.end(), next, from);
    next = from;
    if (next == directory_.end() || next->frame_id != frame_id) pages.push_back({.frame_id = frame_id});
  }
  pages.insert(pages.end(), next, directory_.end());
  std::vector<Bound> bounds;
  bounds.reserve(pages.size());
  begin_frames(pages);
  for (std::size_t p = 0; p < pages.size(); ++p) {
    const bool first_of_frame = p == 0 || pages[p].frame_id != pages[p - 1].frame_id;
    bounds.push_back({first_of_frame ? 0 : pages[p].morton, first_of_frame ? 0 : pages[p].id, pages[p].frame_id});
  }
  std::vector<std::uint32_t> first = first_items(stream_, items_.data(), count, bounds);
  first.push_back(count);

  Plan plan;
  plan.directory.reserve(pages.size() + 64);
  for (std::size_t p = 0; p < pages.size(); ++p) plan_page(plan, pages[p], first[p], first[p + 1] - first[p]);

  added_.resize(rows);
  // Every byte of kNotInserted is the same.
  if (count < rows) device::fill(stream_, added_.data(), 0xFF, added_.bytes());
  place_appends(stream_, items_.data(), count, plan.appends, added_.data());
  moved_from_.resize(plan.moved);
  moved_to_.resize(plan.moved);
  const std::vector<Bound> keys = place_splits(stream_, memory_, items_.data(), plan.splits, plan.new_pages,
                                               added_.data(), moved_from_.data(), moved_to_.data());
  for (const Split& split : plan.splits) {
    for (std::uint32_t q = split.first_new_page; q < split.first_new_page + split.new_page_count; ++q) {
      Page& page = plan.directory[plan.new_at[q]];
      // The first of them goes on from where the old page began.
      if (q > split.first_new_page) {
        page.morton = keys[q].morton;
        page.id = keys[q].id;
      }
      plan.changes.push_back({.page = page.page,
                              .next = {.state = PageState::Active,
                                       .frame_id = page.frame_id,
                                       .count = page.count,
                                       .morton_first = page.morton,
                                       .id_first = page.id},
                              .bounds = {},
                              .fresh = {page.page * kPageLanes, page.count}});
    }
  }
  return plan;
}

void PageStore::copy_moved(std::size_t count) {
  copy_lanes(stream_, memory_, moved_from_.data(), moved_to_.data(), count);
  stream_.wait();
  at(ChangePoint::Copied);
  copy_ids(stream_, memory_, moved_from_.data(), moved_to_.data(), static_cast<std::uint32_t>(count));
  stream_.wait();
  at(ChangePoint::Numbered);
  written_bytes_ += count * memory_.used_rows * sizeof(std::uint32_t);
}

InsertResult PageStore::finish_insert(Plan& plan, std::uint32_t count, const std::optional<BatchKey>& batch) {
  const std::uint64_t first_id = next_gaussian_id();
  number(stream_, memory_, added_.data(), count, first_id);
  stream_.wait();
  copy_moved(plan.moved);
  at(ChangePoint::Written);
  written_bytes_ += std::uint64_t{count} * memory_.used_rows * sizeof(std::uint32_t);
  bound(plan.changes);
  directory_ = std::move(plan.directory);
  apply(plan.changes, first_id + count, batch);
  if (plan.left_out > 0 && !said_full_) {
    said_full_ = true;
    spdlog::warn("model: all {} pages are in use, {} of {} new Gaussians are left out; later ones are without a word",
                 table_.page_capacity(), plan.left_out, count);
  }
  return {.count = count,
          .left_out = plan.left_out + plan.known,
          .added = added_.data(),
          .moves = {plan.moved, moved_from_.data(), moved_to_.data()}};
}

InsertResult PageStore::insert(const InsertRows& rows, std::size_t count, const SceneState& scene, std::uint64_t epoch,
                               std::uint64_t batch) {
  const BatchKey key{epoch, batch};
  if (table_.holds(key)) return {};
  const std::uint32_t n = taken(count);
  if (n == 0) {
    apply({}, next_gaussian_id(), key);
    return {};
  }
  items_.resize(n);
  list_rows(stream_, rows, n, next_gaussian_id(), items_.data());
  const std::uint32_t fresh = drop_spilled(stream_, rows, spilled_, items_.data(), n);
  if (fresh == 0) {
    apply({}, next_gaussian_id(), key);
    return {.count = n, .left_out = n};
  }
  Plan plan = place(fresh, n);
  plan.known = n - fresh;
  const float* appearance = rows.albedo;
  std::size_t stride = rows.stride;
  if (layout_.appearance == Appearance::Radiance) {
    scratch_.resize(std::size_t{3} * n);
    light_rows(stream_, rows, n, insert_light(scene.light), object_rotations(scene.objects), scratch_.data());
    appearance = scratch_.data();
    stride = n;
  }
  write_rows(stream_, memory_, layout_, rows, appearance, stride, items_.data(), fresh, added_.data());
  return finish_insert(plan, n, key);
}

InsertResult PageStore::duplicate(const std::uint32_t* indices, std::size_t count) {
  const std::uint32_t n = taken(count);
  if (n == 0) return {};
  items_.resize(n);
  list_copies(stream_, memory_, indices, n, device_ranges_.data(), static_cast<std::uint32_t>(ranges_.size()),
              next_gaussian_id(), items_.data());
  Plan plan = place(n, n);
  copy_lanes(stream_, memory_, indices, added_.data(), n);
  return finish_insert(plan, n, std::nullopt);
}

RemoveResult PageStore::remove(const std::uint8_t* dead) {
  return remove(dead, {});
}

RemoveResult PageStore::remove(const std::uint8_t* dead, const std::vector<std::uint32_t>& also) {
  std::vector<LaneRange> pages;
  pages.reserve(ranges_.size());
  for (const IndexRange& range : ranges_) pages.push_back({range.first, range.count});
  const std::vector<PageRemoval> removals = count_dead(stream_, dead, pages);
  std::vector<LaneRange> touched;
  std::vector<std::uint32_t> first_move;
  std::vector<PageChange> changes;
  RemoveResult result;
  for (std::size_t p = 0; p < pages.size(); ++p) {
    const std::uint32_t page = pages[p].first >> kPageShift;
    if (removals[p].dead == 0 && !std::binary_search(also.begin(), also.end(), page)) continue;
    touched.push_back(pages[p]);
    first_move.push_back(static_cast<std::uint32_t>(result.moves.count));
    result.removed += removals[p].dead;
    result.moves.count += removals[p].holes;
    PageChange change{.page = page, .next = table_.entry(page).now, .bounds = {}, .fresh = {}};
    change.next.count -= removals[p].dead;
    change.next.state = PageState::Active;
    change.fresh = {pages[p].first, change.next.count};
    if (change.next.count == 0) change.next = {};
    changes.push_back(change);
  }
  if (touched.empty()) return result;
  for (const PageChange& change : changes) table_.open(change.page);
  at(ChangePoint::Opened);
  clear_dead_ids(stream_, memory_, dead, touched);
  at(ChangePoint::Cleared);
  moved_from_.resize(result.moves.count);
  moved_to_.resize(result.moves.count);
  list_moves(stream_, dead, touched, first_move, moved_from_.data(), moved_to_.data());
  copy_moved(result.moves.count);
  result.moves.from = moved_from_.data();
  result.moves.to = moved_to_.data();
  bound(changes);
  std::erase_if(directory_, [&](Page& page) {
    const auto change = std::lower_bound(changes.begin(), changes.end(), page.page,
                                         [](const PageChange& c, std::uint32_t wanted) { return c.page < wanted; });
    if (change == changes.end() || change->page != page.page) return false;
    page.count = change->next.count;
    return page.count == 0;
  });
  apply(changes, next_gaussian_id(), std::nullopt);
  said_full_ = false;
  return result;
}

Moves PageStore::merge() {
  std::vector<Page> kept;
  std::vector<LaneMove> lanes;
  std::vector<PageChange> changes;
  std::uint32_t moved = 0;
  bool grows = false;  // the last that is kept
  const auto rests = [&](const Page& page) { return table_.entry(page.page).now.state == PageState::Frozen; };
  for (const Page& page : directory_) {
    Page* const into = kept.empty() ? nullptr : &kept.back();
    if (into == nullptr || rests(page) || rests(*into) || into->frame_id != page.frame_id ||
        into->count + page.count > fill_target()) {
      kept.push_back(page);
      grows = false;
      continue;
    }
    if (!grows)
      changes.push_back({.page = into->page, .next = table_.entry(into->page).now, .bounds = {}, .fresh = {}});
    grows = true;
    lanes.push_back({page.page * kPageLanes, into->page * kPageLanes + into->count, page.count, moved});
    moved += page.count;
    into->count += page.count;
    changes.back().next.count = into->count;
    changes.back().fresh = {into->page * kPageLanes, into->count};
  }
  if (moved == 0) return {};
  for (const LaneMove& gone : lanes) {
    changes.push_back({.page = gone.from / kPageLanes, .next = {}, .bounds = {}, .fresh = {}});
  }
  moved_from_.resize(moved);
  moved_to_.resize(moved);
  list_moves(stream_, lanes, moved_from_.data(), moved_to_.data());
  copy_moved(moved);
  at(ChangePoint::Written);
  bound(changes);
  directory_ = std::move(kept);
  apply(changes, next_gaussian_id(), std::nullopt);
  said_full_ = false;
  return {moved, moved_from_.data(), moved_to_.data()};
}

void PageStore::apply(const std::vector<PageChange>& changes, std::uint64_t next_gaussian_id,
                      const std::optional<BatchKey>& batch) {
  for (const PageChange& change : changes) table_.propose(change.page, change.next);
  at(ChangePoint::Proposed);
  table_.commit(next_gaussian_id, batch);
  at(ChangePoint::Committed);
  for (std::size_t c = 0; c < changes.size(); ++c) {
    table_.fold(changes[c].page, changes[c].bounds);
    if (c == 0) at(ChangePoint::FoldedOne);
    if (changes[c].next.state == PageState::Free) free_.push_back(changes[c].page);
  }
  table_.close();
  at(ChangePoint::Folded);
  std::sort(free_.begin(), free_.end(), std::greater<>());
  refresh_ranges();
}

}  // namespace splatbus::model
