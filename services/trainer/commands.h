#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <unordered_set>
#include <utility>
#include <vector>

#include "trainer/insert_batch.h"

namespace splatbus::trainer {

struct CellsCommand {
  std::unordered_set<std::uint64_t> cells;
  bool freeze = false;
};

struct VisibilityCommand {
  std::uint64_t model_generation = 0;
  std::size_t count = 0;
  Device memory = Device::Cpu;
  std::shared_ptr<const std::byte> visibility;  ///< floats, as they came
};

/// What others ask of the model, in order of arrival within each kind. Bounded: the optimizer takes all of it between
/// two steps, but those who ask do not wait for it.
struct Commands {
  static constexpr std::size_t kMaxRows = std::size_t{1} << 22;  ///< of all inserts together
  static constexpr std::size_t kMaxInserts = 4096;
  static constexpr std::size_t kMaxCells = std::size_t{1} << 20;  ///< of all cell commands together

  std::vector<InsertBatch> inserts;
  std::vector<CellsCommand> cells;
  std::optional<VisibilityCommand> visibility;  ///< the newest

  /// False when there is no room for it. A batch that waits here already is not taken twice.
  [[nodiscard]] bool add(InsertBatch&& batch);
  [[nodiscard]] bool add(CellsCommand&& command);

  [[nodiscard]] bool empty() const { return inserts.empty() && cells.empty() && !visibility; }
};

/// Hands commands from the message thread to the optimizer's, which takes them between two steps.
class CommandQueue {
 public:
  template <class Edit>
  void post(Edit&& edit) {
    {
      const std::scoped_lock lock(mutex_);
      std::forward<Edit>(edit)(commands_);
      woken_ = true;
    }
    wake_.notify_one();
  }

  /// Wakes wait() without a command: a view has arrived.
  void wake() {
    post([](Commands&) {});
  }

  [[nodiscard]] Commands take() {
    const std::scoped_lock lock(mutex_);
    return std::exchange(commands_, {});
  }

  /// For commands that were taken and could not be obeyed: those that nobody sends again come first the next time.
  /// Inserts are sent again until they are acknowledged.
  void give_back(Commands&& commands);

  /// Until something is posted or `timeout` has passed.
  void wait(std::chrono::milliseconds timeout) {
    std::unique_lock lock(mutex_);
    wake_.wait_for(lock, timeout, [&] { return woken_; });
    woken_ = false;
  }

 private:
  std::mutex mutex_;
  std::condition_variable wake_;
  Commands commands_;
  bool woken_ = false;
};

}  // namespace splatbus::trainer
