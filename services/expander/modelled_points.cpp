#include "expander/modelled_points.h"

#include <algorithm>
#include <unordered_set>
#include <utility>

#include "model/page_table.h"

namespace splatbus::expander {

namespace {

constexpr unsigned kIndexLevel = kReportLevel + 3;  // a page of 1,024 Gaussians is about as wide
constexpr std::uint32_t kArenaLanes = model::kArenaPages * kPageLanes;

std::size_t points_in(std::span<const CellCount> cells) {
  std::size_t points = 0;
  for (const CellCount& cell : cells) points += cell.count;
  return points;
}

/// Ascending, each once.
std::vector<CellKey> parents_of(std::span<const CellCount> cells, unsigned level) {
  std::vector<CellKey> parents;
  for (const CellCount& cell : cells) {
    const CellKey parent = parent_of(cell.key, level);
    if (parents.empty() || !(parents.back() == parent)) parents.push_back(parent);
  }
  return parents;
}

/// Calls visit() with each cell of `level` that the cell, of a level below, or one beside it lies in.
template <class Visit>
void for_each_parent_about(const CellKey& cell, unsigned level, const Visit& visit) {
  const unsigned shift = level - cell.level;
  const CellCoordinates at = unpack_cell(cell);
  // Coordinates are offset by half a range of whole parents, so that shifting negative ones rounds as it should.
  for (std::int64_t x = (at.x - 1) >> shift; x <= (at.x + 1) >> shift; ++x) {
    for (std::int64_t y = (at.y - 1) >> shift; y <= (at.y + 1) >> shift; ++y) {
      for (std::int64_t z = (at.z - 1) >> shift; z <= (at.z + 1) >> shift; ++z) {
        visit(pack_cell({x, y, z}, cell.object_id, level));
      }
    }
  }
}

bool same_units(std::span<const ObjectFrame> a, std::span<const ObjectFrame> b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const ObjectFrame& left, const ObjectFrame& right) {
    return left.id == right.id && left.object_from_world.scale == right.object_from_world.scale;
  });
}

}  // namespace

ModelledPoints::ModelledPoints(device::StreamView stream, float cell_size_m, CellTable& cells)
    : stream_(stream), cell_size_m_(cell_size_m), cells_(cells), near_(stream, cell_size_m) {}

float ModelledPoints::metres_per_unit(std::uint32_t frame_id) const {
  return ObjectFrames{objects_.data(), static_cast<std::uint32_t>(objects_.size())}.metres_per_unit(frame_id);
}

bool ModelledPoints::read(const PublishedModel& model, std::uint64_t trainer_epoch) {
  const GaussiansView& view = model.live();
  const bool same_trainer = trainer_epoch == trainer_epoch_;
  std::vector<PageRange> changed;
  std::vector<std::uint64_t> generations;
  std::vector<bool> present(pages_.size(), false);
  for (std::size_t i = 0; i < view.ranges.size(); ++i) {
    const IndexRange& range = view.ranges[i];
    const std::uint32_t page = range.first >> kPageShift;
    if (page < pages_.size()) {
      present[page] = true;
      const Page& known = pages_[page];
      if (same_trainer && known.range.count > 0 && known.generation == model.page_generations()[i]) continue;
    }
    changed.push_back({range, metres_per_unit(range.frame_id)});
    generations.push_back(model.page_generations()[i]);
  }
  device::Buffer<ModelledPoint> points(stream_, changed.size() << kPageShift);
  const PageCells found = read_pages(stream_,
                                     {.surface_point = view.surface_point,
                                      .normal = view.normal,
                                      .stride = view.stride,
                                      .page_shift = view.page_shift,
                                      .page_stride = view.page_stride},
                                     changed, cell_size_m_, points.data());
  if (!model.still_valid()) return false;

  for (std::uint32_t page = 0; page < present.size(); ++page) {
    if (!present[page]) drop_page(page);
  }
  for (std::size_t i = 0; i < changed.size(); ++i) {
    take_page(changed[i].range.first >> kPageShift,
              {.generation = generations[i],
               .range = changed[i].range,
               .cells = {found.cells.begin() + found.first[i], found.cells.begin() + found.first[i + 1]}},
              points.data() + (i << kPageShift));
  }
  stream_.wait();  // for `points`
  trainer_epoch_ = trainer_epoch;
  pages_read_ += changed.size();
  drop_added();
  return true;
}

void ModelledPoints::take_page(std::uint32_t page, Page&& now, const ModelledPoint* points) {
  drop_page(page);
  if (page >= pages_.size()) pages_.resize(page + 1);
  device::copy(stream_, lanes_of(page), points, now.range.count * sizeof(ModelledPoint));
  pages_[page] = std::move(now);
  size_ += points_in(pages_[page].cells);
  cells_.add_modelled(pages_[page].cells);
  index_page(page);
  near_valid_ = false;
}

void ModelledPoints::drop_page(std::uint32_t page) {
  if (page >= pages_.size() || pages_[page].range.count == 0) return;
  unindex_page(page);
  size_ -= points_in(pages_[page].cells);
  cells_.remove_modelled(pages_[page].cells);
  pages_[page] = {};
  near_valid_ = false;
}

void ModelledPoints::index_page(std::uint32_t page) {
  const Page& entry = pages_[page];
  if (entry.range.frame_id != kWorldFrame) {
    object_index_[entry.range.frame_id].push_back(page);
    return;
  }
  for (const CellKey& cell : parents_of(entry.cells, kIndexLevel)) world_index_[cell].push_back(page);
}

void ModelledPoints::unindex_page(std::uint32_t page) {
  const Page& entry = pages_[page];
  if (entry.range.frame_id != kWorldFrame) {
    const auto of_object = object_index_.find(entry.range.frame_id);
    std::erase(of_object->second, page);
    if (of_object->second.empty()) object_index_.erase(of_object);
    return;
  }
  for (const CellKey& cell : parents_of(entry.cells, kIndexLevel)) {
    const auto there = world_index_.find(cell);
    std::erase(there->second, page);
    if (there->second.empty()) world_index_.erase(there);
  }
}

ModelledPoint* ModelledPoints::lanes_of(std::uint32_t page) {
  const std::uint32_t arena = page / model::kArenaPages;
  while (arenas_.size() <= arena) arenas_.emplace_back(stream_, kArenaLanes);
  return arenas_[arena].data() + std::size_t{page % model::kArenaPages} * kPageLanes;
}

void ModelledPoints::add(std::span<const InsertBatch* const> batches) {
  std::vector<InsertChannels> channels;
  channels.reserve(batches.size());
  for (const InsertBatch* batch : batches) {
    channels.push_back(batch->channels());
    added_.push_back(
        {*batch, cells_of(stream_, batch->channels(), frames_of(batch->scene.objects), cell_size_m_, kReportLevel)});
    size_ += points_in(added_.back().cells);
    cells_.add_modelled(added_.back().cells);
  }
  if (near_valid_) near_.add(channels, objects_);
}

void ModelledPoints::drop_added() {
  if (added_.empty()) return;
  for (const Added& added : added_) {
    size_ -= points_in(added.cells);
    cells_.remove_modelled(added.cells);
  }
  added_.clear();
  near_valid_ = false;
}

void ModelledPoints::clear() {
  for (std::uint32_t page = 0; page < pages_.size(); ++page) drop_page(page);
  drop_added();
  pages_.clear();
  arenas_.clear();
  trainer_epoch_ = 0;
}

std::vector<std::uint32_t> ModelledPoints::pages_near(std::span<const CellCount> cells) const {
  std::vector<bool> near(pages_.size(), false);
  const auto take = [&](const std::vector<std::uint32_t>& pages) {
    for (const std::uint32_t page : pages) near[page] = true;
  };
  std::unordered_set<CellKey, CellHash> visited;
  const auto visit = [&](const CellKey& cell) {
    if (cell.none() || !visited.insert(cell).second) return;
    if (cell.level == kIndexLevel) {
      const auto found = world_index_.find(cell);
      if (found != world_index_.end()) take(found->second);
      return;
    }
    const auto end = world_index_.lower_bound(first_in(next_of(cell), kIndexLevel));
    for (auto it = world_index_.lower_bound(first_in(cell, kIndexLevel)); it != end; ++it) take(it->second);
  };
  std::uint32_t object_id = kWorldFrame;
  for (const CellCount& cell : cells) {
    if (cell.key.object_id != kWorldFrame) {
      if (std::exchange(object_id, cell.key.object_id) == cell.key.object_id) continue;
      const auto found = object_index_.find(object_id);
      if (found != object_index_.end()) take(found->second);
    } else {
      for_each_parent_about(cell.key, std::max(kIndexLevel, cell.key.level), visit);
    }
  }
  std::vector<std::uint32_t> pages;
  for (std::uint32_t page = 0; page < near.size(); ++page) {
    if (near[page]) pages.push_back(page);
  }
  return pages;
}

const PointGrid& ModelledPoints::near(std::span<const CellCount> cells, std::span<const ObjectFrame> objects) {
  std::vector<std::uint32_t> pages = pages_near(cells);
  const bool same = near_valid_ && same_units(objects, objects_) &&
                    std::includes(near_pages_.begin(), near_pages_.end(), pages.begin(), pages.end());
  objects_.assign(objects.begin(), objects.end());
  if (same) return near_;
  near_pages_ = std::move(pages);
  std::vector<PointBlock> blocks;
  blocks.reserve(near_pages_.size());
  for (const std::uint32_t page : near_pages_) {
    const IndexRange& range = pages_[page].range;
    blocks.push_back({lanes_of(page), range.count, range.frame_id, metres_per_unit(range.frame_id)});
  }
  near_.assign(blocks);
  std::vector<InsertChannels> channels;
  channels.reserve(added_.size());
  for (const Added& added : added_) channels.push_back(added.batch.channels());
  near_.add(channels, objects_);
  near_valid_ = true;
  return near_;
}

bool ModelledPoints::holds_any(const InsertBatch& batch) {
  const std::vector<ObjectFrame> objects = objects_;
  const bool found =
      near(cells_of(stream_, batch.channels(), {}, cell_size_m_, kIndexLevel), {}).holds_any(batch.channels());
  objects_ = objects;
  near_valid_ = false;
  return found;
}

}  // namespace splatbus::expander
