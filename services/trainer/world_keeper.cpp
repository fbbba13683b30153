#include "trainer/world_keeper.h"

#include <spdlog/spdlog.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <exception>
#include <optional>
#include <utility>

#include "trainer/id_set.h"

namespace splatbus::trainer {

namespace {

using namespace std::chrono_literals;
using world::PageKey;

constexpr auto kRetryPeriod = 5s;  // of a disk that has refused
constexpr auto kLastRounds = 3s;   // at the end
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
      writer_(world_) {
  for (const world::Damage& damage : world_->damage()) spdlog::warn("world: {}", damage.text());
  if (const std::size_t lost = world_->lost().size(); lost > 0) {
    spdlog::warn("world: {} pages are damaged and left out; what they held is to be seen anew", lost);
  }
  if (world_->cut_bytes() > 0) {
    spdlog::info("world: {} bytes behind the last commit were cut", world_->cut_bytes());
  }
  if (store_.count() == 0) {
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
      if (auto round = writer_.take_done()) finish(std::move(round));
      if (failing_ || !start_round(Clock::now(), 1e6)) break;
    }
    writer_.wait();
  } catch (const std::exception& error) {
    spdlog::error("world: the last steps are not kept: {}", error.what());
  }
}

void WorldKeeper::restore() {
  const world::WorldProgress progress = world_->progress();
  std::vector<std::pair<PageKey, world::PageEntry>> entries;
  for (const auto& entry : world_->pages()) entries.push_back(entry);
  // Newest first: where damage has left a Gaussian in two pages, the later one is right.
  std::sort(entries.begin(), entries.end(), [](const auto& a, const auto& b) {
    return std::pair(a.second.segment, a.second.offset) > std::pair(b.second.segment, b.second.offset);
  });
  IdSet ids(kMaxIdBytes);
  std::size_t left = 0;
  for (std::size_t first = 0; first < entries.size(); first += kPagesAtOnce) {
    const std::size_t n = std::min(kPagesAtOnce, entries.size() - first);
    std::vector<std::optional<world::Page>> pages(n);
    tbb::parallel_for(std::size_t{0}, n, [&](std::size_t p) { pages[p] = world_->read(entries[first + p].first); });
    std::vector<model::PageContent> contents;
    std::vector<std::size_t> of_page;
    for (std::size_t p = 0; p < n; ++p) {
      if (!pages[p]) continue;
      const PageKey& key = pages[p]->key;
      contents.push_back({{.state = pages[p]->state,
                           .frame_id = key.frame_id,
                           .level = key.level,
                           .count = pages[p]->count,
                           .morton_first = key.morton,
                           .id_first = key.id},
                          pages[p]->words});
      ids.drop_known(store_.layout(), contents.back().structure, pages[p]->words);
      of_page.push_back(first + p);
    }
    const std::vector<std::uint32_t> placed = store_.restore(contents, progress.next_gaussian_id);
    for (std::size_t p = 0; p < placed.size(); ++p) {
      const auto& [key, entry] = entries[of_page[p]];
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
  store_.set_progress(progress.step, progress.views, progress.optimizer_s);
  spdlog::info("world: {} Gaussians at step {} from {}", store_.count(), store_.step(), parameters_.folder);
  if (left > 0) spdlog::warn("world: {} more Gaussians stay in the folder, for there is no room", left);
}

void WorldKeeper::follow() {
  // All of it is to be written once: nobody knows since when the pages of a living model have been as they are.
  for (const auto& [key, entry] : world_->pages()) kept_[key] = {};
  spdlog::info("world: the model that is on the bus stands, and {} follows it", parameters_.folder);
}

void WorldKeeper::turn() {
  if (auto round = writer_.take_done()) finish(std::move(round));
  const auto now = Clock::now();
  if (now < next_round_ || writer_.busy()) return;
  const double elapsed = last_round_ == Clock::time_point{} ? parameters_.period_s : seconds(now - last_round_);
  static_cast<void>(start_round(now, elapsed));
}

void WorldKeeper::finish(std::unique_ptr<KeepRound> round) {
  if (round->error.empty()) {
    if (failing_) spdlog::info("world: {} is written again", parameters_.folder);
    failing_ = false;
    stats_.rounds += 1;
    stats_.pages += round->used;
    if (round->commits) {
      for (const PageKey& key : round->removals) kept_.erase(key);
      committed_ = round->progress;
      uncommitted_.clear();
    }
  } else {
    if (!failing_) {
      spdlog::error("world: {}; the folder stays as it was, and what is learnt now would be lost with this process",
                    round->error);
    }
    failing_ = true;
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
  for (std::size_t c = 0; c < std::min(staged, changed.size()); ++c) stage(*round, changed[c]);
  allowance_bytes_ -= static_cast<double>(round->used * page_bytes);
  if (round->commits) {
    for (const auto& [key, kept] : kept_) {
      if (kept.seen != looks_) round->removals.push_back(key);
    }
    const double affordable = std::max(0.0, allowance_bytes_) / static_cast<double>(page_bytes);
    const std::size_t more = std::min({staged - round->used, stale.size(), static_cast<std::size_t>(affordable)});
    std::partial_sort(stale.begin(), stale.begin() + static_cast<std::ptrdiff_t>(more), stale.end(),
                      [](const Candidate& a, const Candidate& b) { return a.step < b.step; });
    for (std::size_t s = 0; s < more; ++s) stage(*round, stale[s]);
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

void WorldKeeper::stage(KeepRound& round, const Candidate& candidate) {
  if (round.used == round.pages.size()) round.pages.emplace_back();
  StagedPage& staged = round.pages[round.used++];
  const model::PageEntry& entry = store_.table().entry(candidate.page);
  const model::PageMemory& memory = store_.memory();
  const std::size_t words = std::size_t{memory.used_rows} * kRowWords;
  staged.key = candidate.key;
  staged.mark = world::PageMark::Resident;
  staged.structure = entry.now;
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
  return stats;
}

}  // namespace splatbus::trainer
