#include "trainer/world_keeper.h"

#include <spdlog/spdlog.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <exception>
#include <limits>
#include <optional>
#include <set>
#include <utility>

#include "trainer/id_set.h"
#include "trainer/world_bytes.h"

namespace splatbus::trainer {

namespace {

using namespace std::chrono_literals;
using world::PageKey;

constexpr auto kRetryPeriod = 5s;  // of a disk that has refused
constexpr auto kLastRounds = 3s;   // at the end
constexpr int kMostOpenRounds = 4;
constexpr std::size_t kPagesAtOnce = 64;
/// Of the folder's ids, which lie together: what a file may make the trainer take for them.
constexpr std::size_t kMaxIdBytes = std::size_t{1} << 30U;

PageKey key_of(const model::PageStructure& page) {
  return {page.frame_id, page.level, page.morton_first, page.id_first};
}

double seconds(std::chrono::steady_clock::duration duration) {
  return std::chrono::duration<double>(duration).count();
}

}  // namespace

WorldKeeper::WorldKeeper(model::PageStore& store, const WorldParameters& parameters)
    : store_(store),
      parameters_(parameters),
      stream_(device::thread_stream(store.device())),
      world_(std::make_shared<world::World>(parameters.folder, world::WorldOptions{.layout = store.layout()})),
      committed_(world_->progress()),
      most_pages_(most_pages(parameters, store.layout(), store.device())),
      writer_(world_) {
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

WorldKeeper::~WorldKeeper() {
  if (std::uncaught_exceptions() > 0) return;  // whatever failed, the last commit is sound
  try {
    stream_ = device::thread_stream(store_.device());
    for (const auto end = Clock::now() + kLastRounds; !failing_ && Clock::now() < end;) {
      writer_.wait();
      if (auto round = writer_.take_done()) finish(std::move(round), [](const auto& change) { change(); });
      if (failing_ || !start_round(Clock::now(), 1e6)) break;
    }
    writer_.wait();
  } catch (const std::exception& error) {
    spdlog::error("world: the last steps are not kept: {}", error.what());
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
  for (const auto& entry : world_->pages()) entries.push_back(entry);
  // Newest first: where damage has left a Gaussian in two pages, the later one is right.
  std::sort(entries.begin(), entries.end(), [](const auto& a, const auto& b) {
    return std::pair(a.second.segment, a.second.offset) > std::pair(b.second.segment, b.second.offset);
  });
  if (most_pages_ != std::numeric_limits<std::size_t>::max()) {
    std::erase_if(entries, [&](const auto& entry) {
      const bool away = entry.second.mark == world::PageMark::Spilled;
      if (away) elsewhere_.insert(entry);
      return away;
    });
    const std::size_t room = most_pages_ - most_pages_ / 8;
    while (entries.size() > room) {
      elsewhere_.insert(entries.back());
      entries.pop_back();
    }
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
      const model::PageEntry& now = store_.table().entry(placed[p]);
      const bool whole = now.now.count == entry.count;
      kept_[key] = {.page = placed[p], .generation = whole ? now.generation.load() : 0, .step = progress.step};
    }
  }
  tell_spilled();
  mark_elsewhere(progress);
  store_.set_progress(progress.step, progress.views, progress.optimizer_s);
  spdlog::info("world: {} Gaussians at step {} from {}", store_.count(), store_.step(), parameters_.folder);
  if (left > 0) spdlog::warn("world: {} more Gaussians stay in the folder, for there is no room", left);
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

void WorldKeeper::turn(const Restructure& restructure) {
  if (auto round = writer_.take_done()) finish(std::move(round), restructure);
  finish_fetch(restructure);
  start_fetch();
  const auto now = Clock::now();
  if (now < next_round_ || writer_.busy()) return;
  const double elapsed = last_round_ == Clock::time_point{} ? parameters_.period_s : seconds(now - last_round_);
  static_cast<void>(start_round(now, elapsed));
  if (open_rounds_ < kMostOpenRounds) return;
  // Pages change faster than rounds take them: the rest goes while nothing changes, or nothing would ever be kept.
  while (open_rounds_ > 0 && !failing_) {
    writer_.wait();
    if (auto round = writer_.take_done()) finish(std::move(round), restructure);
    if (!failing_) static_cast<void>(start_round(Clock::now(), 0));
  }
}

void WorldKeeper::finish(std::unique_ptr<KeepRound> round, const Restructure& restructure) {
  if (round->error.empty()) {
    if (failing_) spdlog::info("world: {} is written again", parameters_.folder);
    failing_ = false;
    stats_.rounds += 1;
    stats_.pages += round->used;
    if (round->commits) {
      for (const PageKey& key : round->removals) kept_.erase(key);
      committed_ = round->progress;
      uncommitted_.clear();
      spill(*round, restructure);
    }
  } else {
    if (!failing_) {
      spdlog::error("world: {}; the folder stays as it was, and what is learnt now would be lost with this process",
                    round->error);
    }
    failing_ = true;
    ++stats_.refused_rounds;
    for (const PageKey& key : uncommitted_) kept_[key].generation = 0;
    uncommitted_.clear();
    next_round_ = Clock::now() + kRetryPeriod;
  }
  spare_ = std::move(round);
}

void WorldKeeper::look(std::vector<Candidate>& changed, std::vector<Candidate>& stale) {
  ++looks_;
  const std::uint64_t step = store_.step();
  for (const IndexRange& range : store_.view().ranges) {
    const std::uint32_t page = range.first >> kPageShift;
    const model::PageEntry& entry = store_.table().entry(page);
    const PageKey key = key_of(entry.now);
    Kept& kept = kept_[key];
    kept.seen = looks_;
    const std::uint64_t generation = entry.generation.load(std::memory_order_relaxed);
    if (kept.generation != generation || kept.page != page) {
      changed.push_back({key, page, 0});
    } else if (entry.now.state == model::PageState::Active && kept.step < step) {
      stale.push_back({key, page, kept.step});
    }
  }
}

bool WorldKeeper::start_round(Clock::time_point now, double elapsed_s) {
  const auto begin = Clock::now();
  std::vector<Candidate> changed, stale;
  look(changed, stale);
  const std::size_t page_bytes = model::page_bytes(store_.layout());
  const std::size_t staged = std::max<std::size_t>(1, parameters_.staging_bytes / page_bytes);
  const double most = static_cast<double>(staged * page_bytes);
  allowance_bytes_ = std::min(most, allowance_bytes_ + elapsed_s * static_cast<double>(parameters_.bytes_per_s));

  auto round = spare_ ? std::move(spare_) : std::make_unique<KeepRound>();
  round->used = 0;
  round->removals.clear();
  round->progress = {.next_gaussian_id = store_.next_gaussian_id(),
                     .step = store_.step(),
                     .views = store_.views(),
                     .optimizer_s = store_.table().header().optimizer_s,
                     .generation = store_.generation()};
  // A commit has all that has changed since the one before, however many rounds it takes: no page is in the folder as
  // it was before a split, and its other half as after it.
  round->commits = changed.size() <= staged;
  open_rounds_ = round->commits ? 0 : open_rounds_ + 1;
  const std::vector<Candidate> victims = round->commits ? choose_victims() : std::vector<Candidate>{};
  std::set<PageKey> leaving;
  for (const Candidate& victim : victims) leaving.insert(victim.key);
  for (std::size_t c = 0; c < std::min(staged, changed.size()); ++c) {
    const bool leaves = leaving.erase(changed[c].key) > 0;
    stage(*round, changed[c], leaves ? world::PageMark::Spilled : world::PageMark::Resident);
  }
  for (const Candidate& victim : victims) {
    if (round->used < staged && leaving.contains(victim.key)) stage(*round, victim, world::PageMark::Spilled);
  }
  std::erase_if(stale, [&](const Candidate& page) { return leaving.contains(page.key); });
  allowance_bytes_ -= static_cast<double>(round->used * page_bytes);
  if (round->commits) {
    for (const auto& [key, kept] : kept_) {
      if (kept.seen != looks_) round->removals.push_back(key);
    }
    forget(*round);
    const double affordable = std::max(0.0, allowance_bytes_) / static_cast<double>(page_bytes);
    const std::size_t more = std::min({staged - round->used, stale.size(), static_cast<std::size_t>(affordable)});
    std::partial_sort(stale.begin(), stale.begin() + static_cast<std::ptrdiff_t>(more), stale.end(),
                      [](const Candidate& a, const Candidate& b) { return a.step < b.step; });
    for (std::size_t s = 0; s < more; ++s) stage(*round, stale[s], world::PageMark::Resident);
    allowance_bytes_ -= static_cast<double>(more * page_bytes);
  }
  stream_.wait();
  const bool any = round->used > 0 || !round->removals.empty() || (round->commits && !uncommitted_.empty());
  const double spent_s = seconds(Clock::now() - begin);
  stats_.copy_s += spent_s;
  stats_.longest_copy_s = std::max(stats_.longest_copy_s, spent_s);
  last_round_ = now;
  next_round_ =
      round->commits
          ? now + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(parameters_.period_s))
          : now;
  if (!any) {
    spare_ = std::move(round);
    return false;
  }
  writer_.start(std::move(round));
  return true;
}

void WorldKeeper::stage(KeepRound& round, const Candidate& candidate, world::PageMark mark) {
  if (round.used == round.pages.size()) round.pages.emplace_back();
  StagedPage& staged = round.pages[round.used++];
  const model::PageEntry& entry = store_.table().entry(candidate.page);
  const model::PageMemory& memory = store_.memory();
  const std::size_t words = std::size_t{memory.used_rows} * kRowWords;
  staged.key = candidate.key;
  staged.mark = mark;
  staged.structure = entry.now;
  // One that rests because no view showed it has not settled (Freezer): its loss does not go along, and once back it
  // would rest at whatever it is first seen with.
  if (entry.now.state == model::PageState::Frozen && entry.loss == 0) staged.structure.state = model::PageState::Active;
  staged.bounds = entry.bounds;
  staged.step = store_.step();
  staged.block.resize(words);
  device::copy(stream_, staged.block.data(), memory.words + candidate.page * memory.page_words,
               words * sizeof(std::uint32_t));
  Kept& kept = kept_[candidate.key];
  kept.page = candidate.page;
  kept.generation = entry.generation.load(std::memory_order_relaxed);
  kept.step = staged.step;
  uncommitted_.push_back(candidate.key);
}

WorldKeeper::Stats WorldKeeper::stats() const {
  Stats stats = stats_;
  stats.disk_bytes = world_->bytes();
  stats.spilled_pages = elsewhere_.size();
  for (const auto& [key, entry] : elsewhere_) stats.spilled += entry.count;
  return stats;
}

}  // namespace splatbus::trainer
