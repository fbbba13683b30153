#include "trainer/world_writer.h"

#include <spdlog/spdlog.h>
#include <sys/resource.h>
#include <tbb/parallel_for.h>
#include <unistd.h>

#include <algorithm>
#include <utility>

#include "model/page_content.h"

namespace splatbus::trainer {

namespace {

constexpr std::size_t kEncodedAtOnce = 32;

}  // namespace

WorldWriter::WorldWriter(std::shared_ptr<world::World> world)
    : world_(std::move(world)), thread_([this](const std::stop_token& stop) { run(stop); }) {}

bool WorldWriter::busy() const {
  const std::scoped_lock lock(mutex_);
  return next_ || writing_ || done_;
}

void WorldWriter::start(std::unique_ptr<KeepRound> round) {
  {
    const std::scoped_lock lock(mutex_);
    next_ = std::move(round);
  }
  changed_.notify_all();
}

std::unique_ptr<KeepRound> WorldWriter::take_done() {
  const std::scoped_lock lock(mutex_);
  return std::move(done_);
}

void WorldWriter::wait() const {
  awaited_ = true;
  std::unique_lock lock(mutex_);
  changed_.wait(lock, [&] { return !next_ && !writing_; });
  awaited_ = false;
}

void WorldWriter::run(const std::stop_token& stop) {
  // Of this thread alone, on Linux. Training comes first.
  static_cast<void>(::setpriority(PRIO_PROCESS, static_cast<id_t>(::gettid()), 10));
  while (true) {
    std::unique_ptr<KeepRound> round;
    {
      std::unique_lock lock(mutex_);
      if (!changed_.wait(lock, stop, [&] { return next_ != nullptr; })) return;
      round = std::move(next_);
      writing_ = true;
    }
    round->error.clear();
    try {
      write(*round);
    } catch (const std::exception& error) {
      round->error = error.what();
      try {
        world_->abandon();
      } catch (const world::WorldError&) {  // Cut at the next opening.
      }
    }
    const bool committed = round->commits && round->error.empty();
    {
      const std::scoped_lock lock(mutex_);
      done_ = std::move(round);
      writing_ = false;
    }
    changed_.notify_all();
    if (!committed) continue;
    try {
      while (world_->compact() && world_->is_crowded() && !stop.stop_requested()) {
      }
    } catch (const std::exception& error) {
      spdlog::warn("world: {}", error.what());
    }
  }
}

void WorldWriter::write(KeepRound& round) {
  const ParameterLayout& layout = world_->layout();
  std::vector<world::Page> pages(kEncodedAtOnce);
  std::vector<std::vector<std::byte>> payloads(kEncodedAtOnce);
  const auto encode = [&](const StagedPage& staged, std::size_t at) {
    world::Page& page = pages[at];
    page.key = staged.key;
    page.mark = staged.mark;
    page.state = staged.structure.state;
    page.count = staged.structure.count;
    page.step = staged.step;
    page.bounds = staged.bounds;
    page.words.resize(model::content_words(layout, page.count));
    model::pack_page(layout, staged.block.data(), page.count, page.words.data());
    page.morton_last = model::last_morton_key(layout, {staged.structure, page.words});
    payloads[at] = world::encode_page(page, layout);
  };
  for (std::size_t first = 0; first < round.used;) {
    const std::size_t n = round.hurries || awaited_ ? std::min(kEncodedAtOnce, round.used - first) : 1;
    if (n == 1) {
      encode(round.pages[first], 0);
    } else {
      tbb::parallel_for(std::size_t{0}, n, [&](std::size_t p) { encode(round.pages[first + p], p); });
    }
    for (std::size_t p = 0; p < n; ++p) world_->put(pages[p], payloads[p]);
    first += n;
  }
  for (const world::PageKey& key : round.removals) world_->remove(key);
  for (const world::PageKey& key : round.fetched) world_->mark(key, world::PageMark::Fetched);
  for (const world::PageKey& key : round.leaving) world_->mark(key, world::PageMark::Spilled);
  if (round.commits) world_->commit(round.progress);
}

}  // namespace splatbus::trainer
