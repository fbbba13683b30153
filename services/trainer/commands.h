#pragma once

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

#include "trainer/insert_reader.h"
#include "trainer/view_store.h"

namespace splatbus::trainer {

/// Of one scene version, by index of a structure's generation, in memory of the model's kind: 255 sees all of the
/// light.
struct VisibilityCommand {
  std::uint64_t model_generation = 0, scene_version = 0;
  std::size_t count = 0;
  std::vector<std::uint32_t> light_ids{0};  ///< of the rows: [light_ids.size()][count]
  std::shared_ptr<std::byte> visibility;    ///< whoever takes the command may write to it
  /// Replicas that share the pages; 0: this is all of them. This is part `part`, which says what `pages` see.
  std::uint32_t parts = 0, part = 0;
  std::uint64_t division = 0;  ///< which replicas they are
  std::vector<std::uint32_t> pages;

  [[nodiscard]] bool replaces(const VisibilityCommand& before) const {
    return before.scene_version == scene_version &&
           (parts == 0 || (before.parts == parts && before.part == part && before.division == division));
  }
};

/// What others ask of the model, in order of arrival within each kind. Bounded: the optimizer takes all of it between
/// two steps, but those who ask do not wait for it.
struct Commands {
  static constexpr std::size_t kMaxRows = std::size_t{1} << 22;  ///< of all inserts together
  static constexpr std::size_t kMaxInserts = 4096;
  static constexpr std::size_t kMaxVisibilities = 64;

  std::vector<InsertBatch> inserts;
  std::vector<TrainingViewPtr> pictures;        ///< that bring depth: the newest of each camera
  std::vector<VisibilityCommand> visibilities;  ///< one a scene version, or a part of it

  /// False when there is no room for it. A batch that waits here already is not taken twice.
  [[nodiscard]] bool add(InsertBatch&& batch) {
    std::size_t rows = batch.count;
    for (const InsertBatch& waiting : inserts) {
      if (waiting.epoch == batch.epoch && waiting.batch == batch.batch) return true;
      rows += waiting.count;
    }
    if (rows > kMaxRows || inserts.size() >= kMaxInserts) return false;
    inserts.push_back(std::move(batch));
    return true;
  }

  /// Takes a picture that has arrived, if it brings depth.
  void look(TrainingViewPtr view) {
    if (view->depth.empty()) return;
    const auto same = [&](const TrainingViewPtr& other) { return key_of(*other) == key_of(*view); };
    const auto found = std::find_if(pictures.begin(), pictures.end(), same);
    if (found == pictures.end()) {
      pictures.push_back(std::move(view));
    } else {
      *found = std::move(view);
    }
  }

  /// Takes the place of what waits for the same version, or, where too many wait, of the oldest.
  void add(VisibilityCommand&& visibility) {
    std::erase_if(visibilities, [&](const auto& waiting) { return visibility.replaces(waiting); });
    if (visibilities.size() >= kMaxVisibilities) visibilities.erase(visibilities.begin());
    visibilities.push_back(std::move(visibility));
  }

  [[nodiscard]] bool empty() const { return inserts.empty() && pictures.empty() && visibilities.empty(); }
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
