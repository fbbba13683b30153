// How a WorldKeeper's store and its folder come together.

#include <spdlog/spdlog.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <limits>
#include <optional>
#include <set>
#include <utility>

#include "trainer/id_set.h"
#include "trainer/world_ids.h"
#include "trainer/world_keeper.h"

namespace splatbus::trainer {

namespace {

using world::PageKey;

constexpr std::size_t kPagesAtOnce = 64;
constexpr std::size_t kSegmentsInDisk = 32;
/// Of the folder's ids, which lie together: what a file may make the trainer take for them.
constexpr std::size_t kMaxIdBytes = std::size_t{1} << 30U;

}  // namespace

void WorldKeeper::open() {
  world::WorldOptions options{.layout = store_.layout(), .max_bytes = parameters_.disk_bytes};
  if (parameters_.disk_bytes > 0) {
    options.segment_bytes = std::min(options.segment_bytes, parameters_.disk_bytes / kSegmentsInDisk);
  }
  try {
    world_ = std::make_shared<world::World>(parameters_.folder, options);
  } catch (const world::DiskFull& error) {
    // Of a new world, which has nothing to lose.
    if (!failing_) spdlog::error("world: {}; what is learnt would be lost with this process", error.what());
    failing_ = true;
    ++stats_.refused_rounds;
    next_round_ = Clock::now() + kRetryPeriod;
    return;
  }
  writer_.emplace(world_);
  committed_ = world_->progress();
  for (const world::Damage& damage : world_->damage()) spdlog::warn("world: {}", damage.text());
  if (const std::size_t lost = world_->lost().size(); lost > 0) {
    spdlog::warn("world: {} pages are damaged and left out; what they held is to be seen anew", lost);
  }
  if (world_->cut_bytes() > 0) {
    spdlog::info("world: {} bytes behind the last commit were cut", world_->cut_bytes());
  }
  // A restore that was cut short has not told its step yet; it goes on.
  if (store_.count() == 0 || (store_.step() == 0 && committed_.step > 0)) {
    restore();
  } else {
    follow();
  }
}

void WorldKeeper::mark_elsewhere(const world::WorldProgress& progress) try {
  bool any = false;
  for (auto& [key, entry] : elsewhere_) {
    if (entry.mark == world::PageMark::Spilled) continue;
    world_->mark(key, world::PageMark::Spilled);
    entry.mark = world::PageMark::Spilled;
    any = true;
  }
  if (any) world_->commit(progress);
} catch (const world::WorldError& error) {
  spdlog::error("world: {}", error.what());
  world_->abandon();
}

void WorldKeeper::restore() {
  const world::WorldProgress progress = world_->progress();
  std::vector<std::pair<PageKey, world::PageEntry>> entries;
  for (const auto& entry : world_->pages()) entries.emplace_back(entry);
  // Newest first: where damage has left a Gaussian in two pages, the later one is right.
  std::sort(entries.begin(), entries.end(), [](const auto& a, const auto& b) {
    return std::pair(a.second.segment, a.second.offset) > std::pair(b.second.segment, b.second.offset);
  });
  if (ceiling_bytes_ > 0 || ceiling_gaussians_ > 0) {
    constexpr std::size_t kNone = std::numeric_limits<std::size_t>::max();
    const std::size_t most_bytes = ceiling_bytes_ > 0 ? ceiling_bytes_ / 8 * 7 : kNone;
    const std::size_t most_gaussians = ceiling_gaussians_ > 0 ? ceiling_gaussians_ - ceiling_gaussians_ / 8 : kNone;
    std::size_t bytes = 0, gaussians = 0;
    const auto choose = [&](bool fetched) {
      for (const auto& [key, entry] : entries) {
        if ((entry.mark == world::PageMark::Fetched) != fetched) continue;
        const std::size_t page = cost_.all(entry.state != model::PageState::Frozen);
        if (entry.mark == world::PageMark::Spilled || bytes + page > most_bytes ||
            gaussians + entry.count > most_gaussians) {
          elsewhere_.emplace(key, entry);
        } else {
          bytes += page;
          gaussians += entry.count;
        }
      }
    };
    // First what had come back: viewers were near, and its records are older than all others.
    choose(true);
    choose(false);
    std::erase_if(entries, [&](const auto& entry) { return elsewhere_.contains(entry.first); });
  }
  IdSet ids(kMaxIdBytes);
  std::size_t left = 0;
  for (std::size_t first = 0; first < entries.size(); first += kPagesAtOnce) {
    const std::size_t n = std::min(kPagesAtOnce, entries.size() - first);
    std::vector<std::optional<world::Page>> pages(n);
    tbb::parallel_for(std::size_t{0}, n, [&](std::size_t p) { pages[p] = world_->read(entries[first + p].first); });
    for (auto& page : pages) {
      if (page) ids.drop_known(store_.layout(), page->count, page->words);
    }
    const std::vector<std::uint32_t> placed = put_in(pages, progress.next_gaussian_id);
    for (std::size_t p = 0; p < placed.size(); ++p) {
      const auto& [key, entry] = entries[first + p];
      if (!pages[p]) continue;
      if (placed[p] == model::kNotInserted && store_.room() >= entry.count && store_.has_page()) {
        kept_[key] = {};  // nothing of it is of use: out of the folder
        continue;
      }
      if (placed[p] == model::kNotInserted) {
        elsewhere_[key] = entry;
        left += entry.count;
        continue;
      }
      kept_[key] = kept_as(*pages[p], placed[p], progress.step);
    }
  }
  tell_spilled();
  mark_elsewhere(progress);
  store_.set_progress(progress.step, progress.views, progress.optimizer_s);
  spdlog::info("world: {} Gaussians at step {} from {}", store_.count(), store_.step(), parameters_.folder);
  if (left > 0) spdlog::warn("world: {} more Gaussians stay in the folder, as there is no room", left);
}

std::vector<std::uint32_t> WorldKeeper::put_in(Pages& pages, std::uint64_t next_gaussian_id) {
  std::vector<model::PageContent> contents;
  for (const auto& page : pages) {
    const PageKey key = page ? page->key : PageKey{};
    contents.push_back({{.state = page ? page->state : model::PageState::Free,
                         .frame_id = key.frame_id,
                         .level = key.level,
                         .count = page ? page->count : 0,
                         .morton_first = key.morton,
                         .id_first = key.id},
                        page ? std::span<const std::uint32_t>(page->words) : std::span<const std::uint32_t>()});
  }
  return store_.restore(contents, next_gaussian_id);
}

WorldKeeper::Kept WorldKeeper::kept_as(const world::Page& page, std::uint32_t placed, std::uint64_t step) const {
  const model::PageEntry& entry = store_.table().entry(placed);
  // Of one that has lost Gaussians, for nobody can use them, the folder is to have what is left.
  if (entry.now.count != page.count) return {.page = placed};
  std::vector<std::uint64_t> ids;
  for (std::uint32_t lane = 0; lane < page.count; ++lane) {
    ids.push_back(model::id_of(store_.layout(), {entry.now, page.words}, lane));
  }
  return {.page = placed,
          .generation = entry.generation.load(),
          .step = step,
          .ids = hash_of_ids(ids),
          .spilled = page.mark == world::PageMark::Spilled};
}

void WorldKeeper::follow() {
  // All of it is to be written once: nobody knows since when the pages of a living model have been as they are.
  std::set<PageKey> resident;
  IdSet ids(kMaxIdBytes);
  const model::PageMemory& memory = store_.memory();
  std::vector<std::uint64_t> of_page;
  for (const IndexRange& range : store_.view().ranges) {
    resident.insert(key_of(store_.table().entry(range.first >> kPageShift).now));
    of_page.resize(range.count);
    device::copy(stream_, of_page.data(), memory.wide(memory.gaussian_id, range.first),
                 of_page.size() * sizeof(std::uint64_t));
    stream_.wait();
    for (const std::uint64_t id : of_page) static_cast<void>(ids.add(id));
  }
  for (const auto& [key, entry] : world_->pages()) {
    kept_[key] = {};
    if (entry.mark != world::PageMark::Spilled || resident.contains(key)) continue;
    // On its way out or back when the trainer died, it may be here under other keys.
    const auto page = world_->read(key);
    if (!page) continue;
    const model::PageStructure structure{.count = page->count};
    bool here = false;
    for (std::uint32_t lane = 0; lane < page->count && !here; ++lane) {
      here = ids.contains(model::id_of(store_.layout(), {structure, page->words}, lane));
    }
    if (here) continue;
    kept_.erase(key);
    elsewhere_[key] = entry;
  }
  tell_spilled();
  spdlog::info("world: the model that is on the bus stands, and {} follows it", parameters_.folder);
}

}  // namespace splatbus::trainer
