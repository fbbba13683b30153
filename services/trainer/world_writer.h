#pragma once

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "gaussians/pages.h"
#include "model/page_table.h"
#include "world/world.h"

namespace splatbus::trainer {

/// A page as it was copied, with the lanes that hold nothing.
struct StagedPage {
  world::PageKey key;
  world::PageMark mark = world::PageMark::Resident;
  model::PageStructure structure;
  PageBounds bounds;
  std::uint64_t step = 0;
  std::vector<std::uint32_t> block;
};

/// What goes to the folder at once.
struct KeepRound {
  std::vector<StagedPage> pages;  ///< the first `used` of them; the others are memory for the next round
  std::size_t used = 0;
  std::vector<world::PageKey> removals;
  std::vector<world::PageKey> leaving;  ///< pages that the folder has as they are, and that are to be there alone
  std::vector<world::PageKey> fetched;  ///< pages that are in memory again, as the folder has them
  bool hurries = false;                 ///< somebody waits for what it makes room for
  bool commits = false;                 ///< with this round all since the last commit is what there is now
  world::WorldProgress progress;
  std::string error;  ///< when it is done: why nothing since the last commit was written
};

/// Compresses pages and writes them to a world on a thread of its own, which gives way to all others, and with all
/// cores as long as somebody waits for it. One round at a time; start() and take_done() from one thread.
class WorldWriter {
 public:
  explicit WorldWriter(std::shared_ptr<world::World> world);

  [[nodiscard]] bool busy() const;
  /// When not busy.
  void start(std::unique_ptr<KeepRound> round);
  /// The round that has ended; null while it goes on, and when there is none.
  [[nodiscard]] std::unique_ptr<KeepRound> take_done();
  /// Until it has ended.
  void wait() const;

 private:
  void run(const std::stop_token& stop);
  void write(KeepRound& round);

  std::shared_ptr<world::World> world_;
  mutable std::atomic<bool> awaited_ = false;
  mutable std::mutex mutex_;
  mutable std::condition_variable_any changed_;
  std::unique_ptr<KeepRound> next_, done_;
  bool writing_ = false;
  std::jthread thread_;  // last: it ends first
};

}  // namespace splatbus::trainer
