#include "trainer/world_keeper.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cstring>
#include <exception>
#include <set>
#include <utility>

#include "trainer/world_ids.h"

namespace splatbus::trainer {

namespace {

using namespace std::chrono_literals;
using world::PageKey;

constexpr auto kLastRounds = 3s;  // at the end
constexpr int kMostOpenRounds = 4;
constexpr std::size_t kRoundsInDisk = 8;
constexpr std::size_t kPagesToldApart = 256;  // at once

double seconds(std::chrono::steady_clock::duration duration) {
  return std::chrono::duration<double>(duration).count();
}

}  // namespace

WorldKeeper::WorldKeeper(model::PageStore& store, const WorldParameters& parameters)
    : store_(store),
      parameters_(parameters),
      cost_(store.layout()),
      ceiling_bytes_(store.device() == Device::Cpu ? parameters.host_bytes : parameters.device_bytes),
      ceiling_gaussians_(parameters.max_gaussians),
      stream_(device::thread_stream(store.device())) {
  open();
}

WorldKeeper::~WorldKeeper() {
  if (!writer_ || std::uncaught_exceptions() > 0) return;  // whatever failed, the last commit is sound
  try {
    stream_ = device::thread_stream(store_.device());
    wanted_m_.clear();  // nothing comes back any more: nothing leaves for it, or round by round all would
    for (const auto end = Clock::now() + kLastRounds; !failing_ && Clock::now() < end;) {
      writer_->wait();
      if (auto round = writer_->take_done()) finish(std::move(round), [](const auto& change) { change(); });
      if (failing_ || !start_round(Clock::now(), 1e6)) break;
    }
    writer_->wait();
  } catch (const std::exception& error) {
    spdlog::error("world: the last steps are not kept: {}", error.what());
  }
}

void WorldKeeper::turn(const Restructure& restructure) {
  if (!world_) {
    if (Clock::now() >= next_round_) restructure([this] { open(); });
    return;
  }
  if (auto round = writer_->take_done()) finish(std::move(round), restructure);
  finish_fetch(restructure);
  start_fetch();
  const auto now = Clock::now();
  if (writer_->busy() || (now < next_round_ && !hurries(now))) return;
  const double elapsed = last_round_ == Clock::time_point{} ? parameters_.period_s : seconds(now - last_round_);
  static_cast<void>(start_round(now, elapsed));
  if (open_rounds_ < kMostOpenRounds) return;
  // Pages change faster than rounds take them: the rest goes while nothing changes, or nothing would ever be kept.
  while (open_rounds_ > 0 && !failing_) {
    writer_->wait();
    if (auto round = writer_->take_done()) finish(std::move(round), restructure);
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
      for (const PageKey& key : round->fetched) {
        if (const auto found = kept_.find(key); found != kept_.end()) found->second.spilled = false;
      }
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
  std::vector<Candidate> other;
  for (const IndexRange& range : store_.view().ranges) {
    const std::uint32_t page = range.first >> kPageShift;
    const model::PageEntry& entry = store_.table().entry(page);
    const PageKey key = key_of(entry.now);
    Kept& kept = kept_[key];
    kept.seen = looks_;
    const std::uint64_t generation = entry.generation.load(std::memory_order_relaxed);
    if (kept.generation == generation && kept.page == page) {
      if (entry.now.state == model::PageState::Active && kept.step < step) stale.push_back({key, page, kept.step});
    } else if (kept.generation == 0 || kept.ids == 0 || kept.page != page) {
      changed.push_back({key, page, 0});
    } else if (kept.same == generation) {
      stale.push_back({key, page, kept.step});
    } else {
      other.push_back({key, page, kept.step});
    }
  }
  tell_apart(other, changed, stale);
}

void WorldKeeper::tell_apart(std::span<const Candidate> other, std::vector<Candidate>& changed,
                             std::vector<Candidate>& stale) {
  const model::PageMemory& memory = store_.memory();
  std::vector<std::uint64_t> ids(std::min(other.size(), kPagesToldApart) * kPageLanes);
  for (std::size_t first = 0; first < other.size(); first += kPagesToldApart) {
    const auto some = other.subspan(first, std::min(kPagesToldApart, other.size() - first));
    for (std::size_t c = 0; c < some.size(); ++c) {
      const std::uint32_t page = some[c].page;
      device::copy(stream_, ids.data() + c * kPageLanes, memory.wide(memory.gaussian_id, page * kPageLanes),
                   store_.table().entry(page).now.count * sizeof(std::uint64_t));
    }
    stream_.wait();
    for (std::size_t c = 0; c < some.size(); ++c) {
      const model::PageEntry& entry = store_.table().entry(some[c].page);
      Kept& kept = kept_[some[c].key];
      if (hash_of_ids(std::span(ids).subspan(c * kPageLanes, entry.now.count)) == kept.ids) {
        kept.same = entry.generation.load(std::memory_order_relaxed);
        stale.push_back(some[c]);
      } else {
        changed.push_back(some[c]);
      }
    }
  }
}

bool WorldKeeper::start_round(Clock::time_point now, double elapsed_s) {
  const auto begin = Clock::now();
  std::vector<Candidate> changed, stale;
  look(changed, stale);
  const std::size_t page_bytes = model::page_bytes(store_.layout());
  // No round takes a disk beyond its ceiling before what it leaves behind can be compacted.
  const std::size_t on_disk = parameters_.disk_bytes > 0 ? parameters_.disk_bytes / kRoundsInDisk : SIZE_MAX;
  const std::size_t staged = std::max<std::size_t>(1, std::min(parameters_.staging_bytes, on_disk) / page_bytes);
  const auto most = static_cast<double>(staged * page_bytes);
  allowance_bytes_ = std::min(most, allowance_bytes_ + elapsed_s * static_cast<double>(parameters_.bytes_per_s));

  auto round = spare_ ? std::move(spare_) : std::make_unique<KeepRound>();
  round->used = 0;
  round->removals.clear();
  round->leaving.clear();
  round->fetched.clear();
  round->hurries = !wanted_m_.empty();
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
    if (!leaving.contains(victim.key)) continue;
    if (is_kept(victim)) {
      round->leaving.push_back(victim.key);
    } else if (round->used < staged) {
      stage(*round, victim, world::PageMark::Spilled);
    }
  }
  std::erase_if(stale, [&](const Candidate& page) { return leaving.contains(page.key); });
  allowance_bytes_ -= static_cast<double>(round->used * page_bytes);
  if (round->commits) {
    for (const auto& [key, kept] : kept_) {
      if (kept.seen != looks_) {
        round->removals.push_back(key);
      } else if (kept.spilled && !leaving.contains(key)) {
        round->fetched.push_back(key);
      }
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
  note_ids(*round);
  const bool any = round->used > 0 || !round->removals.empty() || !round->leaving.empty() || !round->fetched.empty() ||
                   (round->commits && !uncommitted_.empty());
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
  writer_->start(std::move(round));
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
  kept.spilled = false;
  uncommitted_.push_back(candidate.key);
}

void WorldKeeper::note_ids(const KeepRound& round) {
  const std::size_t row = std::size_t{store_.memory().gaussian_id} * kRowWords;
  std::vector<std::uint64_t> ids(kPageLanes);
  for (const StagedPage& page : std::span(round.pages).first(round.used)) {
    std::memcpy(ids.data(), page.block.data() + row, page.structure.count * sizeof(std::uint64_t));
    kept_[page.key].ids = hash_of_ids(std::span(ids).first(page.structure.count));
  }
}

WorldKeeper::Stats WorldKeeper::stats() const {
  Stats stats = stats_;
  stats.disk_bytes = world_ ? world_->bytes() : 0;
  stats.spilled_pages = elsewhere_.size();
  for (const auto& [key, entry] : elsewhere_) stats.spilled += entry.count;
  return stats;
}

}  // namespace splatbus::trainer
